"""`--store` and related settings."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosld.server.resources.mirror import authorization
from rosld.server.settings import Settings


def test_endpoints_are_those_of_oxigraph_unless_named() -> None:
    for given, endpoints in (
        ({}, None),
        ({"store": "http://h:7878"}, ("http://h:7878/query", "http://h:7878/update")),
        ({"store": "https://h/ds/"}, ("https://h/ds/query", "https://h/ds/update")),
        ({"store": "http://h", "store_update": "http://h/statements"}, ("http://h/query", "http://h/statements")),
        ({"store_query": "http://h/q", "store_update": "http://h/u"}, ("http://h/q", "http://h/u")),
    ):
        assert Settings(**given).store_endpoints == endpoints  # type: ignore[arg-type]


WRONG: list[dict[str, object]] = [
    *({"store": store} for store in ("h:7878", "ftp://h/", "http://user:secret@h/", "http://h:99999/", "")),
    *({"store": store} for store in ("http://h/?key=1", "http://h/#x", "http://h/a b", "http://h/\r\nX: y")),
    {"store_query": "http://h/q"},
    {"store_update": "http://h/u"},
    {"store_credentials": Path("x")},
    {"store": "http://h", "store_rate": 0},
]


def test_what_is_no_store_is_refused_with_the_option_and_no_secret() -> None:
    for given in WRONG:
        with pytest.raises(ValueError, match="--store") as error:
            Settings(**given)  # type: ignore[arg-type]
        assert "secret" not in str(error.value), given


def test_credentials_become_a_header_or_are_refused_and_not_shown(tmp_path: Path) -> None:
    file = tmp_path / "credentials"
    for text, header in {
        "Aladdin:open sesame\n": "Basic QWxhZGRpbjpvcGVuIHNlc2FtZQ==",
        "user:a:b": "Basic dXNlcjphOmI=",
        "Bearer abc.def\n": "Bearer abc.def",
    }.items():
        file.write_text(text)
        assert authorization(file) == header
    for text in ("", "nothing", "user:pass\r\nX-Header: y", "Bearer a\nb", "Bearer é", "\x00:"):
        file.write_text(text)
        with pytest.raises(ValueError, match="--store-credentials") as error:
            authorization(file)
        assert not text or text not in str(error.value)
