"""Reading bodies: complete, within limits of size and time."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest
from starlette.requests import Request
from starlette.types import Message

from rosld.server.http import body
from rosld.server.http.body import read_body
from rosld.server.http.problem import Problem


def request(chunks: Sequence[bytes], headers: Sequence[tuple[bytes, bytes]] = (), *, then: str = "end") -> Request:
    """Return a request with a body in chunks; `then`: the body ends, the client disconnects, or nothing follows."""
    coming = iter(chunks)

    async def receive() -> Message:
        chunk = next(coming, None)
        if chunk is not None:
            return {"type": "http.request", "body": chunk, "more_body": True}
        if then == "nothing":
            await asyncio.Event().wait()
        return {"type": "http.request", "more_body": False} if then == "end" else {"type": "http.disconnect"}

    return Request({"type": "http", "method": "PUT", "path": "/", "headers": list(headers)}, receive)


def status(asked: Request, *, limit: int = 10, timeout: float = 5.0) -> tuple[int, str]:
    with pytest.raises(Problem) as raised:
        asyncio.run(read_body(asked, limit=limit, timeout=timeout))
    return raised.value.status, raised.value.detail


def test_a_body_that_is_or_says_it_is_too_large_is_413(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body, "LINGER_SECONDS", 0.01)
    for then in ("end", "nothing", "disconnect"):
        assert status(request([b"x"], [(b"content-length", b"11")], then=then), timeout=60)[0] == 413
        assert status(request([b"12345", b"67890", b"1"], then=then), timeout=60)[0] == 413


def test_a_client_that_waits_to_be_told_to_go_on_is_answered_at_once() -> None:
    asked = request([], [(b"content-length", b"11"), (b"expect", b"100-continue")], then="nothing")
    assert status(asked)[0] == 413


def test_a_length_that_is_no_number_or_not_that_of_the_body_is_400() -> None:
    for length in (b"-1", b"1e3", b"", b"0x10", b"1,1", b"9" * 30, "²".encode("latin-1", "replace")):
        assert status(request([b"x"], [(b"content-length", length)]))[0] == 400
    code, detail = status(request([b"abc"], [(b"content-length", b"7")]))
    assert (code, "7" in detail, "3" in detail) == (400, True, True)


def test_a_body_that_never_ends_is_408_and_one_that_is_cut_off_400() -> None:
    assert status(request([b"abc"], then="nothing"), timeout=0.01)[0] == 408
    assert status(request([b"abc"], then="disconnect"))[0] == 400
