"""The real HTTP server with an application of a test, on the test's own loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.types import ASGIApp

from rosld.server.serving.connection import ConnectionBounds
from rosld.server.serving.http_server import Server, bind


@asynccontextmanager
async def listening(app: ASGIApp, bounds: ConnectionBounds | None = None) -> AsyncIterator[int]:
    """Yield the port of a server, which has ended afterwards."""
    listens = asyncio.Event()
    server = Server(app, listens.set, bounds)
    sock = bind("127.0.0.1", 0)
    serving = asyncio.create_task(server.serve(sockets=[sock]))
    try:
        await asyncio.wait_for(listens.wait(), 60)
        yield sock.getsockname()[1]
    finally:
        server.should_exit = True
        await serving


async def exchange(port: int, *pieces: bytes) -> bytes:
    """Return everything that a new connection receives after these pieces until it is closed."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        for piece in pieces:
            writer.write(piece)
            await writer.drain()
        return await reader.read()
    finally:
        writer.close()
