"""Resources of the protocol: the URLs of the server, and notifications of their changes."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Awaitable, Callable
from contextlib import suppress
from urllib.parse import quote

import orjson
from mcp import types
from mcp.server.subscriptions import InMemorySubscriptionBus, ListenHandler, ResourceUpdated
from mcp.shared.exceptions import MCPError

from rosld.server.mcp.results import DATA, fit
from rosld.server.mcp.tools import Context, Refusal, Tools, with_query
from rosld.server.mcp.transport import Caller
from rosld.server.runtime.tasks import end_tasks

MAX_SUBSCRIPTIONS = 32
"""Maximum number of URLs that one client is notified of at once."""
PAUSE_SECONDS = 1.0
"""Minimum time between two notifications of one URL."""
_ERROR_SECONDS = 5.0
_WAIT_SECONDS = 60
_JSON = "application/json"
_NOT_FOUND = -32002
_MAIN = (
    ("", "Entry point", "This server, with links to everything else."),
    ("resources/", "Resources", "The robot as resources, each with its value."),
    ("topics/", "Topics", "The topics, each with its type and latest value."),
    ("services/", "Services", "The services that can be called."),
    ("actions/", "Actions", "The actions that goals can be sent to."),
    ("parameters/", "Parameters", "The settings of nodes."),
    ("goals/", "Goals", "The goals that were sent, and how they ended."),
    ("diagnostics", "Diagnostics", "What nodes report about their state."),
    ("status", "Status", "The state of this server."),
    ("stop", "Stop", "Whether the robot is stopped, by whom and why."),
    ("queries/", "Queries", "Stored SPARQL queries."),
    ("activity/", "Receipts", "Receipts of writes: by whom, what, and the outcome."),
)


class Subscriptions:
    """Resources, read by the requests that `tools` make, and subscriptions to them."""

    def __init__(self, tools: Tools) -> None:
        self._tools = tools
        base = tools.space.base
        self._resources = [
            types.Resource(uri=f"{base}{path}", name=title, title=title, description=about, mime_type=_JSON)
            for path, title, about in _MAIN
        ]
        about = "Any URL of this server: topics, values, goals, receipts, documents. Cameras return pictures."
        self._template = types.ResourceTemplate(
            uri_template=f"{base}{{+path}}", name="url", title="Any URL", description=about, mime_type=_JSON
        )

    async def list_resources(self, context: Context, params: object) -> types.ListResourcesResult:
        """Return the main resources."""
        return types.ListResourcesResult(resources=self._resources)

    async def list_templates(self, context: Context, params: object) -> types.ListResourceTemplatesResult:
        """Return the template of all URLs."""
        return types.ListResourceTemplatesResult(resource_templates=[self._template])

    async def read(self, context: Context, params: types.ReadResourceRequestParams) -> types.ReadResourceResult:
        """Return a resource: a picture of an image, else JSON. Raises MCPError."""
        uri = str(params.uri)
        answer = await self._tools.get(
            self._tools.caller(context), self._url(uri), f"image/jpeg, {_JSON};q=0.9, */*;q=0.1"
        )
        media_type = (answer.field("content-type") or "").partition(";")[0]
        if answer.status >= 400:
            data, _ = fit(self._tools.value(answer), self._tools.space.base, 1000)
            code = _NOT_FOUND if answer.status in (404, 410) else types.INVALID_PARAMS
            raise MCPError(code, f"The server answered {answer.status}.", data={"uri": uri, "problem": data})
        contents: types.BlobResourceContents | types.TextResourceContents
        if media_type.startswith("image/") and answer.body is not None:
            blob = base64.b64encode(answer.body).decode("ascii")
            contents = types.BlobResourceContents(uri=uri, mime_type=media_type, blob=blob)
        else:
            data, is_cut = fit(self._tools.value(answer), self._tools.space.base, self._tools.budget)
            whole = {"note": DATA, "data": data, **({"cut": f"Shortened; GET {uri}"} if is_cut else {})}
            contents = types.TextResourceContents(uri=uri, mime_type=_JSON, text=orjson.dumps(whole).decode())
        return types.ReadResourceResult(contents=[contents])

    async def listen(
        self, context: Context, params: types.SubscriptionsListenRequestParams
    ) -> types.SubscriptionsListenResult:
        """Notify of changes until the client disconnects (2026-07-28)."""
        uris = list(params.notifications.resource_subscriptions or ())
        self._require_few(len(uris))
        bus, caller = InMemorySubscriptionBus(), self._tools.caller(context)

        async def publish(uri: str) -> None:
            await bus.publish(ResourceUpdated(uri))

        watches = [asyncio.ensure_future(self._watch(caller, uri, self._url(uri), publish)) for uri in uris]
        try:
            return await ListenHandler(bus)(context, params)
        finally:
            await end_tasks(watches)

    async def subscribe(self, context: Context, params: types.SubscribeRequestParams) -> types.EmptyResult:
        """Notify of changes until the session ends (2025-11-25)."""
        uri = str(params.uri)
        watches, session = _watches(context), context.session
        if uri not in watches:
            self._require_few(len(watches) + 1)
            work = self._watch(self._tools.caller(context), uri, self._url(uri), session.send_resource_updated)
            watches[uri] = asyncio.ensure_future(work)
        return types.EmptyResult()

    async def unsubscribe(self, context: Context, params: types.UnsubscribeRequestParams) -> types.EmptyResult:
        """End the notifications of a URL."""
        watch = _watches(context).pop(str(params.uri), None)
        if watch is not None:
            await end_tasks([watch])
        return types.EmptyResult()

    def _url(self, uri: str) -> str:
        try:
            return self._tools.url(uri)
        except Refusal as refusal:
            raise MCPError(_NOT_FOUND, "The URI is of another server.", data={"uri": uri}) from refusal

    def _require_few(self, count: int) -> None:
        if count > MAX_SUBSCRIPTIONS:
            raise MCPError(types.INVALID_PARAMS, f"A client can subscribe to {MAX_SUBSCRIPTIONS} URLs at most.")

    async def _watch(self, caller: Caller, uri: str, url: str, notify: Callable[[str], Awaitable[None]]) -> None:
        """Notify of every change of a URL, until cancelled or the agent may no longer read it."""
        known: str | None = None
        while True:
            query = "" if known is None else f"after={quote(known, safe='')}&timeout={_WAIT_SECONDS}"
            answer = await self._tools.get(caller, with_query(url, query), _JSON)
            if answer.status in (401, 403):
                return
            tag = answer.field("etag")
            if answer.status == 200 and tag is not None and tag != known:
                if known is not None:
                    await notify(uri)
                known = tag
            await asyncio.sleep(PAUSE_SECONDS if answer.status in (200, 304) else _ERROR_SECONDS)


def _watches(context: Context) -> dict[str, asyncio.Future[None]]:
    """Return the watches of a session by URI; they end with it."""
    connection = context.session._connection  # the SDK has no public name for it
    found = connection.state.get("watches")
    if found is None:
        found = connection.state["watches"] = {}

        async def end() -> None:
            with suppress(asyncio.CancelledError):
                await end_tasks(found.values())

        connection.exit_stack.push_async_callback(end)
    watches: dict[str, asyncio.Future[None]] = found
    return watches
