"""The server of the protocol, and its sessions over HTTP. Imports the SDK: only `endpoint.py` and the command do."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from mcp import types
from mcp.server.auth.middleware.bearer_auth import AuthenticatedUser
from mcp.server.auth.provider import AccessToken
from mcp.server.context import ServerRequestContext
from mcp.server.lowlevel.server import Server
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from starlette.types import Receive, Scope, Send

import rosld
from rosld.ontology.urls import Space
from rosld.server.mcp.prompts import INSTRUCTIONS, get_prompt, list_prompts
from rosld.server.mcp.subscriptions import Subscriptions
from rosld.server.mcp.tools import Tools
from rosld.server.mcp.transport import Transport
from rosld.server.settings import Settings

Context = ServerRequestContext[Any, Any]
_MAX_SESSIONS = 256
logging.getLogger("mcp").setLevel(logging.WARNING)


def create_server(
    space: Space, transport: Transport, settings: Settings, authorization: str | None = None
) -> Server[Any]:
    """Return the protocol's server; `authorization` are the credentials of clients that do not connect by HTTP.

    Nothing that it says of itself contains words of the robot.
    """
    tools = Tools(space, transport, settings, authorization)
    subscriptions = Subscriptions(tools)
    schemas = {each.name: each.input_schema for each in tools.listed}

    async def list_tools(context: Context, params: object) -> types.ListToolsResult:
        return types.ListToolsResult(tools=tools.listed)

    return Server(
        "rosld",
        title="rosld",
        version=rosld.__version__,
        instructions=INSTRUCTIONS,
        get_tool_input_schema=schemas.get,  # else the SDK lists all tools with each call
        on_list_tools=list_tools,
        on_call_tool=tools.call,
        on_list_resources=subscriptions.list_resources,
        on_list_resource_templates=subscriptions.list_templates,
        on_read_resource=subscriptions.read,
        on_subscribe_resource=subscriptions.subscribe,
        on_unsubscribe_resource=subscriptions.unsubscribe,
        on_subscriptions_listen=subscriptions.listen,
        on_list_prompts=list_prompts,
        on_get_prompt=get_prompt,
    )


class Sessions:
    """Sessions over HTTP. Each belongs to the agent that opened it."""

    def __init__(self, space: Space, transport: Transport, settings: Settings) -> None:
        server = create_server(space, transport, settings)
        self._manager = StreamableHTTPSessionManager(
            server, max_request_body_size=settings.body_limit, max_sessions=_MAX_SESSIONS
        )

    async def run(self, started: asyncio.Event) -> None:
        """Serve until cancelled."""
        async with self._manager.run():
            started.set()
            await asyncio.Event().wait()

    async def serve(self, scope: Scope, receive: Receive, send: Send, agent: str) -> None:
        """Serve one request of an agent."""
        user = AuthenticatedUser(AccessToken(token="", client_id=agent, scopes=[]))
        fields = [(name, value.strip(b" \t")) for name, value in scope["headers"]]  # the SDK compares them to the body
        await self._manager.handle_request({**scope, "headers": fields, "user": user}, receive, send)
