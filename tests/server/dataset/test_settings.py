"""`--store` and what belongs to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosld.server.resources.mirror_setup import authorization
from rosld.server.settings import Settings


@pytest.mark.parametrize(
    ("given", "endpoints"),
    [
        ({}, None),
        ({"store": "http://h:7878"}, ("http://h:7878/query", "http://h:7878/update")),
        ({"store": "https://h/ds/"}, ("https://h/ds/query", "https://h/ds/update")),
        ({"store": "http://h", "store_update": "http://h/statements"}, ("http://h/query", "http://h/statements")),
        ({"store_query": "http://h/q", "store_update": "http://h/u"}, ("http://h/q", "http://h/u")),
    ],
)
def test_endpoints_are_those_of_oxigraph_unless_named(given: dict[str, str], endpoints: tuple[str, str] | None) -> None:
    assert Settings(**given).store_endpoints == endpoints  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "given",
    [
        {"store": "h:7878"},
        {"store": "ftp://h/"},
        {"store": "http://user:secret@h/"},
        {"store": "http://h:99999/"},
        {"store": "http://h/?key=1"},
        {"store": "http://h/#x"},
        {"store": "http://h/a b"},
        {"store": "http://h/\r\nX: y"},
        {"store": ""},
        {"store_query": "http://h/q"},
        {"store_update": "http://h/u"},
        {"store_credentials": Path("x")},
        {"store": "http://h", "store_rate": 0},
    ],
)
def test_what_is_no_store_is_refused_with_the_option_and_no_secret(given: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="--store") as error:
        Settings(**given)  # type: ignore[arg-type]
    assert "secret" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "header"),
    [
        ("Aladdin:open sesame\n", "Basic QWxhZGRpbjpvcGVuIHNlc2FtZQ=="),
        ("user:a:b", "Basic dXNlcjphOmI="),
        ("Bearer abc.def\n", "Bearer abc.def"),
    ],
)
def test_credentials_become_a_header(text: str, header: str, tmp_path: Path) -> None:
    file = tmp_path / "credentials"
    file.write_text(text)
    assert authorization(file) == header


@pytest.mark.parametrize("text", ["", "nothing", "user:pass\r\nX-Header: y", "Bearer a\nb", "Bearer é", "\x00:"])
def test_credentials_that_are_none_are_refused_and_not_shown(text: str, tmp_path: Path) -> None:
    file = tmp_path / "credentials"
    file.write_text(text)
    with pytest.raises(ValueError, match="--store-credentials") as error:
        authorization(file)
    assert not text or text not in str(error.value)
