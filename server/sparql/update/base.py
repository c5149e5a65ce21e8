"""The contract between the endpoint and what carries updates out."""

from __future__ import annotations

from typing import Protocol

from starlette.responses import Response

from rosld.server.access.judge import EVERYTHING, Judge
from rosld.server.sparql.protocol import UpdateRequest


class Updates(Protocol):
    """Carries out updates."""

    async def answer(
        self, request: UpdateRequest, *, dry_run: bool, accept: str | None, judge: Judge = EVERYTHING
    ) -> Response:
        """Carry an update out, or only say what it would do (`dry_run`); `accept` is the request's Accept field.

        Raises Problems; then nothing was done, unless the problem lists what was.
        """
        ...
