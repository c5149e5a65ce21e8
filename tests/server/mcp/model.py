"""A scripted model: a client of the protocol's SDK that counts its calls and the text that it reads."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from mcp.client.client import Client
from mcp.types import CallToolResult

VERSIONS = ("2026-07-28", "2025-11-25")


class Model:
    """Calls of tools; `data` of a result is what the robot or the server said."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.calls = 0
        self.read = 0
        self.last: CallToolResult | None = None

    async def call(self, tool: str, /, **arguments: Any) -> dict[str, Any]:
        """Call a tool, and return its structured result."""
        self.last = await self.client.call_tool(tool, {name.rstrip("_"): value for name, value in arguments.items()})
        self.calls += 1
        self.read += len(self.last.content[0].text.encode())
        assert isinstance(self.last.structured_content, dict)
        return self.last.structured_content

    async def done(self, tool: str, /, **arguments: Any) -> dict[str, Any]:
        """Call a tool that succeeds."""
        result = await self.call(tool, **arguments)
        assert not self.last.is_error, result
        return result

    async def refused(self, tool: str, /, **arguments: Any) -> str:
        """Call a tool that is refused, and return why."""
        result = await self.call(tool, **arguments)
        assert self.last.is_error, result
        return result.get("refused") or result["data"]["detail"]

    async def request(self, name: str, below: str) -> dict[str, str]:
        """Return a request that is on offer now, by its name."""
        found = await self.done("query", name="what-can-be-done", parameters={"below": below})
        (row,) = (row for row in found["data"]["rows"] if row[1] == name)
        return {"method": row[2], "url": row[3]}


@asynccontextmanager
async def model(server: Any, version: str = VERSIONS[0], **how: Any) -> AsyncIterator[Model]:
    """Connect a model to a URL, or to a command."""
    mode = "legacy" if version == VERSIONS[1] else version
    async with Client(server, mode=mode, **how) as client:
        assert client.protocol_version == version
        yield Model(client)
