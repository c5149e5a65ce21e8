"""Responses whose every byte is ready."""

from __future__ import annotations

from starlette.responses import Response


class Prepared(Response):
    """A response whose header list is ready."""

    def __init__(self, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
        self.status_code = status
        self.body = body
        self.background = None
        self.raw_headers = headers
