"""`rosld mcp`: the tools on stdin and stdout, of a source opened here or of a running server."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import importlib.util
import logging
import os
from collections.abc import Coroutine
from typing import Any

from rosld.adapters.registry import adapter_for
from rosld.ontology.urls import Space
from rosld.server import settings as declared
from rosld.server.cli import data_folder
from rosld.server.cli.failure import Failure, end_signals, user_errors
from rosld.server.mcp.endpoint import NEEDS_SDK
from rosld.server.mcp.transport import RemoteTransport, Transport
from rosld.server.serving.http_server import configure_logging, run
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings

TOKEN = "ROSLD_TOKEN"
"""Environment variable with the access token of the model."""


def serve_tools(source: str, settings: Settings) -> None:
    """Serve the tools until the client or a signal ends them. Raises Failure if that is impossible."""
    configure_logging(settings.log_format)
    if settings.mcp == "off":
        raise Failure("--mcp off: choose read or write")
    if importlib.util.find_spec("mcp") is None:
        raise Failure(NEEDS_SDK)
    importlib.import_module("rosld.server.mcp.protocol")  # takes a second, which would pause the loop
    is_running = source.startswith(("http://", "https://"))
    with user_errors():
        run(_until_signal(_bridge(source, settings) if is_running else _open(source, settings)))


async def _until_signal(work: Coroutine[Any, Any, None]) -> None:
    task = asyncio.ensure_future(work)
    for number in end_signals():
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await task


async def _open(source: str, settings: Settings) -> None:
    """Open a source, and serve the tools of its application, which listens nowhere."""
    from rosld.server.app import create_app

    adapter = adapter_for(source, settings.adapter_options)
    with contextlib.ExitStack() as lasting:
        if settings.data is not None:
            lasting.enter_context(data_folder.lock(settings.data))
            data_folder.bind_base(settings.data, settings.base_url)
        app = create_app(adapter, settings)
        try:
            async with lifespan(app):
                try:
                    await _serve(app.session.space, app.mcp.transport(), settings)
                finally:
                    app.end_streams()
        finally:
            await adapter.close()


async def _bridge(url: str, settings: Settings) -> None:
    """Serve the tools of a running server."""
    from mcp.shared._httpx_utils import create_mcp_http_client

    logging.getLogger("httpx2").setLevel(logging.WARNING)
    async with create_mcp_http_client() as client:
        space = Space(declared.canonical_base(url), settings.types_namespace)
        await _serve(space, RemoteTransport(client), settings)


async def _serve(space: Space, transport: Transport, settings: Settings) -> None:
    from mcp.server.stdio import stdio_server

    from rosld.server.mcp.protocol import create_server

    token = os.environ.get(TOKEN)
    server = create_server(space, transport, settings, None if token is None else f"Bearer {token}")
    async with stdio_server() as (received, sent):
        await server.run(received, sent, server.create_initialization_options())
