"""multipart/form-data: parts are parsed as they were sent, and invalid ones are rejected."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.body import Part, split_parts
from rosld.server.http.negotiation import parse_media_type

TURTLE = parse_media_type("text/turtle")


def body(boundary: str, *contents: bytes, head: bytes = b"Content-Type: text/turtle") -> bytes:
    mark = b"--" + boundary.encode()
    return b"".join(mark + b"\r\n" + head + b"\r\n\r\n" + each + b"\r\n" for each in contents) + mark + b"--\r\n"


@given(st.lists(st.binary()), st.from_regex(r"[0-9a-zA-Z'()+_,./:=?-]{1,70}", fullmatch=True))
def test_parts_come_back_as_they_were_sent(contents: list[bytes], boundary: str) -> None:
    mark = b"--" + boundary.encode()
    kept = [each for each in contents if b"\r\n" + mark not in b"\r\n" + each + b"\r\n"]
    assert split_parts(body(boundary, *kept), boundary) == tuple(Part(TURTLE, each) for each in kept)


def test_a_part_need_not_say_what_it_is() -> None:
    assert split_parts(b"--x \t\r\n\r\na\r\n--x--", "x") == (Part(None, b"a"),)
    assert split_parts(body("x", b"a", head=b'content-disposition: form-data; name="n"'), "x") == (Part(None, b"a"),)


def test_what_is_wrong_is_named() -> None:
    for data, boundary, words in (
        (b"", "x", "does not end in --x--"),
        (b"--x\r\n\r\na", "x", "does not end in --x--"),
        (b"--xy\r\n\r\na\r\n--xy--", "x", "its own line"),
        (b"--x\r\nname: value\r\n--x--", "x", "blank line"),
        (b"--x\r\n" + b"a" * 20_000 + b"\r\n\r\n\r\n--x--", "x", "blank line"),
        (body("x", b"", head=b"Content-Type: nonsense"), "x", "nonsense"),
        (body("x", b"", head=b"Content-Transfer-Encoding: base64"), "x", "base64"),
        (body("x", *[b""] * 2000), "x", "1000 parts"),
        (b"", None, "None"),
        (b"", "", "''"),
        (b"", "x" * 71, "1 to 70"),
        (b"", "a\r\nb", "1 to 70"),
    ):
        with pytest.raises(ValueError, match=r".") as caught:
            split_parts(data, boundary)
        assert words in str(caught.value)


@given(st.binary(), st.text(max_size=5) | st.none())
def test_nothing_that_arrives_makes_it_raise_anything_else(data: bytes, boundary: str | None) -> None:
    with suppress(ValueError):
        split_parts(data, boundary)
    with suppress(ValueError):
        split_parts(b"--x\r\n" + data.replace(b"y", b"\r\n--x"), "x")
