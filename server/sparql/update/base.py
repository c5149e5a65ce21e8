"""The contract between the endpoint and what carries updates out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from starlette.responses import Response

from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.operations import Operation


class UpdateRunner(Protocol):
    """Carries out updates."""

    async def answer(
        self, request: UpdateRequest, *, accept: str | None, permissions: Permissions = ALLOW_ALL
    ) -> Response:
        """Carry an update out; `accept` is the request's Accept field.

        Raises Problems; then nothing was done, unless the problem lists what was.
        """
        ...

    async def carry_out(self, operations: Sequence[Operation], *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Carry out operations, as `answer` does those of an update."""
        ...

    def is_stored(self, graph: str) -> bool:
        """Whether clients keep the graph of this name, or may."""
        ...
