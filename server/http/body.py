"""Reading a request's body: whole, within a size and a time (RFC 9110 8.4 to 8.6)."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncIterator, Coroutine, Mapping
from typing import Protocol

import anyio
from starlette.requests import ClientDisconnect
from starlette.types import Receive

from rosld.server.http.problem import Problem

TIMEOUT = 30.0
"""Seconds a client has to send its body."""
MIN_BYTES_PER_SECOND = 1024
"""Bytes a second that a body must come at on the whole, where it is read as it comes."""
LINGER_SECONDS = 2.0
"""How long a body that is too large is read on and thrown away, so that its client hears why."""


class IncomingRequest(Protocol):
    """A request, as far as its body is concerned: Starlette's is one."""

    @property
    def headers(self) -> Mapping[str, str]:
        """Its header fields; names are in lower case."""
        ...

    @property
    def receive(self) -> Receive:
        """Gives its body, message by message."""
        ...


async def read_body(request: IncomingRequest, *, limit: int, timeout: float = TIMEOUT) -> bytes:
    """The body of a request, of at most `limit` bytes, sent within `timeout` seconds.

    Raises Problems: 413 too large (before reading where Content-Length says so), 415 compressed, 408 too slow, 400 cut
    off or not as long as Content-Length says. A connection whose body was not read to its end is not used again.
    """
    headers = request.headers
    require_identity_coding(headers.get("content-encoding"))
    declared = parse_content_length(headers.get("content-length"))
    if declared is not None and declared > limit:
        await _let_finish(request)
        raise _too_large(limit)
    try:
        body = await _within(timeout, _collect(request.receive, limit))
    except _TooLarge:
        await _let_finish(request)
        raise _too_large(limit) from None
    except TimeoutError as error:
        raise Problem(408, f"The body did not arrive within {timeout:g} s.", headers=_CLOSE) from error
    except ClientDisconnect as error:
        raise Problem(400, "The connection ended within the body.", headers=_CLOSE) from error
    if declared is not None and len(body) != declared:
        raise Problem(400, f"Content-Length says {declared} bytes, the body has {len(body)}.", headers=_CLOSE)
    return body


async def read_chunks(request: IncomingRequest, *, limit: int, timeout: float = TIMEOUT) -> AsyncIterator[bytes]:
    """The body of a request as it comes, each chunk within `timeout` seconds; raises the Problems of `read_body`.

    All of it may take that long and a second more for each `MIN_BYTES_PER_SECOND`, so that no trickle goes on for ever.
    """
    require_identity_coding(request.headers.get("content-encoding"))
    declared = parse_content_length(request.headers.get("content-length"))
    if declared is not None and declared > limit:
        await _let_finish(request)
        raise _too_large(limit)
    size, more, begun = 0, True, time.monotonic()
    while more:
        if time.monotonic() - begun > timeout + size / MIN_BYTES_PER_SECOND:
            words = f"The body came at less than {MIN_BYTES_PER_SECOND} bytes a second, {size} bytes of it."
            raise Problem(408, words, headers=_CLOSE)
        try:
            with anyio.fail_after(timeout):
                message = await request.receive()
        except TimeoutError as error:
            raise Problem(408, f"Nothing of the body arrived for {timeout:g} s.", headers=_CLOSE) from error
        if message["type"] != "http.request":
            raise Problem(400, "The connection ended within the body.", headers=_CLOSE)
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > limit:
            await _let_finish(request)
            raise _too_large(limit)
        if chunk:
            yield chunk
        more = message.get("more_body", False)
    if declared is not None and size != declared:
        raise Problem(400, f"Content-Length says {declared} bytes, the body has {size}.", headers=_CLOSE)


def require_identity_coding(coding: str | None) -> None:
    """Raises a 415 Problem for a compressed body, which could grow without limit (RFC 9110 15.5.16)."""
    if coding is not None and coding.strip().lower() not in ("", "identity"):
        raise Problem(
            415,
            f"Content-Encoding: {coding} is not read here. Send the body as it is.",
            headers={"Accept-Encoding": "identity", **_CLOSE},
        )


def parse_content_length(text: str | None) -> int | None:
    """The number in Content-Length, None where there is none; a 400 Problem where it is no number."""
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise Problem(400, f"Content-Length: {text[:100]!r} is no number of bytes.", headers=_CLOSE)
    return int(text)


_CLOSE = {"Connection": "close"}


class _TooLarge(Exception):
    """The body is larger than its limit."""


async def _collect(receive: Receive, limit: int) -> bytes:
    chunks: list[bytes] = []
    size = 0
    more = True
    while more:
        message = await receive()
        if message["type"] != "http.request":
            raise ClientDisconnect
        chunk: bytes = message.get("body", b"")
        size += len(chunk)
        if size > limit:
            raise _TooLarge
        chunks.append(chunk)
        more = message.get("more_body", False)
    return chunks[0] if len(chunks) == 1 else b"".join(chunks)


async def _within(seconds: float, work: Coroutine[object, object, bytes]) -> bytes:
    """What `work` returns, or TimeoutError. A timer and nothing else: most bodies are there at once."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task(loop)
    assert task is not None
    expired: list[bool] = []

    def expire() -> None:
        expired.append(True)
        task.cancel()

    timer = loop.call_later(seconds, expire)
    try:
        return await work
    except asyncio.CancelledError:
        if not expired:
            raise
        if sys.version_info >= (3, 11):
            task.uncancel()
        raise TimeoutError from None
    finally:
        timer.cancel()


async def _let_finish(request: IncomingRequest) -> None:
    """Read on and throw away: a connection closed while its client sends is reset, and the answer with it.

    A client that waits for 100 Continue is sent its answer at once.
    """
    if "expect" in request.headers:
        return
    with anyio.move_on_after(LINGER_SECONDS):
        while True:
            message = await request.receive()
            if message["type"] != "http.request" or not message.get("more_body", False):
                return


def _too_large(limit: int) -> Problem:
    return Problem(413, f"The body is larger than {limit} bytes, the most that is read here.", headers=_CLOSE)
