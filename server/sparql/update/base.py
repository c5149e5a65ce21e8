"""Interface between the endpoint and the execution of updates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from starlette.responses import Response

from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.operations import Operation


class UpdateRunner(Protocol):
    """Executor of updates."""

    async def answer(self, request: UpdateRequest, *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Execute an update.

        Raises Problems; then nothing was changed, unless the problem lists what was.
        """
        ...

    async def carry_out(self, operations: Sequence[Operation], *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Execute operations, as `answer` does those of an update."""
        ...

    def is_stored(self, graph: str) -> bool:
        """Whether the graph of this name is, or may be, stored for clients."""
        ...
