"""`/asyncapi.json`: the AsyncAPI 3.1 description of what this server sends and receives, by the tables of OpenAPI."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable, Mapping
from functools import partial
from itertools import chain, count
from urllib.parse import urlsplit

import orjson
from starlette.responses import Response

from rosld import __version__
from rosld.adapters.model import Qos, Topic
from rosld.server.auth.authenticator import UNRESTRICTED
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, OBJECT, TEXT, JsonSchema, without_none
from rosld.server.openapi.description import SECURITY_SCHEMES, chosen, permitted_paths, references
from rosld.server.openapi.openapi_resource import OpenApiResource
from rosld.server.openapi.path_collector import DescribedPath
from rosld.server.resources.base import SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.responses import bytes_response, resource_headers
from rosld.server.runtime.version_cache import IdentityKey, VersionCache

MEDIA_TYPES = ("application/json", "application/vnd.aai.asyncapi+json")
_ABOUT = (
    "Operations are those of this server: it sends states and messages as server-sent events (GET with `Accept: "
    "text/event-stream`), and receives those to write (PUT). Channels of ROS 2 are the topics behind them."
)
_ROLES = {"receive": "subscriber", "send": "publisher"}
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9]+")
_SEGMENT = re.compile(r"\{([^{}]+)\}")
_WEB_SOCKET = "/channels/WebSocketChannel2023/{token}/messages"
_STREAM = "/channels/StreamingHTTPChannel2023/{token}/messages"
_MAX_CACHED = 8


class AsyncApiResource(SessionResource):
    """The description, created once for each state of that of OpenAPI and each set of permissions."""

    kind = "Description"
    links = OpenApiResource.links
    item = PathItem("The topics and values as channels (AsyncAPI)", MEDIA_TYPES, OBJECT, (), streams=False)
    path = "asyncapi.json"

    def __init__(self, openapi: OpenApiResource) -> None:
        super().__init__(openapi.services)
        self._openapi = openapi
        self._cache = VersionCache[bytes](_MAX_CACHED)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        media_type = choose_offer(exchange.accept, MEDIA_TYPES)
        if media_type is None:
            raise Problem(406, f"None of {exchange.accept!r} is available; choose from {', '.join(MEDIA_TYPES)}.")
        described = await self._openapi.describe(hidden=False)
        permissions = exchange.permissions
        key, version = permissions.rights_key, IdentityKey(described)
        data = self._cache.find(key, version)
        if data is None:
            paths: Iterable[DescribedPath] = described.paths
            if not permissions.is_unrestricted:
                may = partial(self._openapi.may, permissions)
                paths = await asyncio.to_thread(lambda: [*permitted_paths(described.paths, may, permissions.may_read)])
            session = self.session
            topics: dict[str, Topic] = {}
            if session.adapter.capabilities.system == "ROS 2":
                start = len(self.space.base) - 1
                topics = {self.space.topic(name)[start:]: topic for name, topic in session.graph.topics.items()}
            writer = _Writer(f"rosld: {session.name}", self.space.base, session.graph.own_node, topics)
            is_secured = exchange.auth is not UNRESTRICTED
            data = await asyncio.to_thread(writer.document, paths, described.schemas, is_secured=is_secured)
            self._cache.put(key, version, data)
        etag = ETag(f"{self.services.instance_id}-{digest(data)}", media_type.partition("/")[2].replace(".", "-"))
        return bytes_response(exchange, data, media_type, etag, resource_headers(self).items())


class _Writer:
    """Writer of a document; `topics` are those of ROS 2, by path, and `node` is the server's own node there."""

    def __init__(self, title: str, base: str, node: str, topics: Mapping[str, Topic]) -> None:
        self._title = title
        self._base = urlsplit(base)
        self._node = node
        self._topics = topics
        self._channels: dict[str, object] = {}
        self._operations: dict[str, object] = {}

    def document(self, paths: Iterable[DescribedPath], schemas: Mapping[str, JsonSchema], *, is_secured: bool) -> bytes:
        """Return the document as JSON."""
        for path in sorted(paths, key=lambda each: each.template):
            self._add(path)
        components = {"schemas": schemas}
        needed = chosen(components, references(self._channels, components))
        scheme, host = self._base.scheme, self._base.netloc
        place = {"host": host, "pathname": self._base.path.rstrip("/")} if self._base.path != "/" else {"host": host}
        security = {"security": [_reference("components/securitySchemes", each) for each in SECURITY_SCHEMES]}
        servers: dict[str, object] = {
            name: {**place, "protocol": protocol, **(security if is_secured else {})}
            for name, protocol in (("http", scheme), ("ws", "wss" if scheme == "https" else "ws"))
        }
        if self._topics:
            servers["ros2"] = {"host": "none", "protocol": "ros2", "description": "The domain of the robot."}
        license = {"name": "Apache-2.0", "url": "https://www.apache.org/licenses/LICENSE-2.0"}
        return orjson.dumps(
            {
                "asyncapi": "3.1.0",
                "info": {"title": self._title, "version": __version__, "description": _ABOUT, "license": license},
                "defaultContentType": "application/json",
                "servers": servers,
                "channels": self._channels,
                "operations": self._operations,
                "components": {**needed, **({"securitySchemes": SECURITY_SCHEMES} if is_secured else {})},
            }
        )

    def _add(self, path: DescribedPath) -> None:
        """Add the channels of a path: of a value that changes, of its topic, or of notifications."""
        if path.template in (_WEB_SOCKET, _STREAM):
            server = "ws" if path.template == _WEB_SOCKET else "http"
            self._channel(path.template, path.item.summary, server, {"send": OBJECT}, {}, path.segments)
            return
        if not path.item.has_value or "{" in path.template:
            return
        payloads: dict[str, JsonSchema] = {}
        bindings: dict[str, dict[str, object]] = {}
        if "GET" in path.methods:
            payloads["send"] = path.item.plain or ANYTHING
            bindings["send"] = {"http": {"method": "GET", "query": _FORMAT}}
        if "PUT" in path.methods:
            payloads["receive"] = path.write("PUT").sends or ANYTHING
            bindings["receive"] = {"http": {"method": "PUT"}}
        if payloads:
            self._channel(path.template, path.item.summary, "http", payloads, bindings)
        if (topic := self._topics.get(path.template)) is not None and payloads:
            opposite = {"send": "receive", "receive": "send"}
            profile = next((each.qos for each in (*topic.publishers, *topic.subscribers) if each.qos), None)
            self._channel(
                topic.name,
                path.item.summary,
                "ros2",
                {opposite[action]: payload for action, payload in payloads.items()},
                {
                    action: {"ros2": without_none(role=role, node=self._node, qosPolicies=_policies(profile))}
                    for action, role in _ROLES.items()
                },
            )

    def _channel(
        self,
        address: str,
        title: str,
        server: str,
        payloads: Mapping[str, JsonSchema],
        bindings: Mapping[str, Mapping[str, object]],
        segments: Mapping[str, str] | None = None,
    ) -> None:
        """Add a channel with an operation and a message for each payload, by its action."""
        wanted = f"{server}_{_NOT_IN_A_NAME.sub('_', address).strip('_')}"
        names = chain([wanted], (f"{wanted}_{number}" for number in count(2)))
        name = next(each for each in names if each not in self._channels)
        parameters = {each: {"description": (segments or {})[each]} for each in _SEGMENT.findall(address)}
        messages = {action: {"name": f"{name}_{action}", "payload": payload} for action, payload in payloads.items()}
        self._channels[name] = {
            "address": address,
            "title": title,
            "servers": [_reference("servers", server)],
            "messages": messages,
            **({"parameters": parameters} if parameters else {}),
        }
        for action in payloads:
            self._operations[f"{action}_{name}"] = {
                "action": action,
                "channel": _reference("channels", name),
                "messages": [_reference(f"channels/{name}/messages", action)],
                **({"bindings": bindings[action]} if action in bindings else {}),
            }


_FORMAT: JsonSchema = {"type": "object", "properties": {"format": {**TEXT, "const": "json"}}}


def _reference(place: str, name: str) -> dict[str, str]:
    return {"$ref": f"#/{place}/{name}"}


def _policies(qos: Qos | None) -> dict[str, object] | None:
    """Return the policies of a profile that the binding has words for; times are in nanoseconds, -1 is infinite."""
    if qos is None:
        return None
    times = {"deadline": qos.deadline_ns, "lifespan": qos.lifespan_ns, "leaseDuration": qos.lease_ns}
    words = {name: word for name, known in _POLICIES.items() if (word := getattr(qos, name)) in known}
    return {**words, **{name: -1 if each is None else each for name, each in times.items()}}


_POLICIES = {
    "reliability": ("best_effort",),  # the schema of the binding misspells "reliable", and so refuses it
    "durability": ("transient_local", "volatile"),
    "history": ("keep_last", "keep_all"),
    "liveliness": ("automatic",),
}
"""Words that the binding takes, by policy."""
