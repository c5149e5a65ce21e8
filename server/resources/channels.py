"""Notifications as resources (Solid Notifications Protocol 2): discovery, subscription and reception."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeAlias
from urllib.parse import quote, unquote, urlsplit

import orjson
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope

from rosld.adapters.model import RosError
from rosld.ontology.describe_graph import container_document
from rosld.ontology.document import Document
from rosld.ontology.notifications import (
    CHANNEL_TYPES,
    Json,
    ServiceDescription,
    description_document,
    description_members,
    with_context,
)
from rosld.ontology.urls import Location, locate
from rosld.server.auth import enforcement
from rosld.server.auth.authenticator import AuthContext
from rosld.server.auth.redaction import redact_problem
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.channel_request import JSON_LD, MAX_BYTES, MEDIA_TYPES, check_profile, read_subscription
from rosld.server.events.delivery import LINES, ChannelStream, WebSocketReceiver, channel_headers
from rosld.server.events.notification_channels import NO_CHANNEL, Channel, Channels
from rosld.server.http.body import read_body
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.fields import Link
from rosld.server.http.origin import OriginPolicy, normalize_authority
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import OBJECT, TEXT, URI, JsonSchema, MessageSchemas, json_object
from rosld.server.resources.base import Services
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, JSON, OFFERS
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import (
    BASIC_CONTAINER,
    RDF_SOURCE,
    READ,
    RESOURCE,
    Answer,
    CreatedAnswer,
    Resource,
    permanent_redirect,
)
from rosld.server.rest.responses import RawResponse, bytes_response, resource_headers
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State

WEBSOCKET, STREAMING_HTTP = CHANNEL_TYPES
ROUTE, SOURCE = "channels", "messages"
WELL_KNOWN, THING, VOID = ".well-known", "wot", "void"
STORAGE_DESCRIPTION = "http://www.w3.org/ns/solid/terms#storageDescription"
Resolve: TypeAlias = Callable[[Scope], Resource]
Route: TypeAlias = Callable[[Location], Resource]

_SUBSCRIPTION: JsonSchema = json_object(
    {"@context": {}, "type": TEXT, "topic": URI},
    {**dict.fromkeys(("rate", "state", "startAt", "endAt", "accept"), TEXT)},
)


class Notifications:
    """The notifications of one server: its subscription services, channels and topics.

    `resolve` returns the resource of a request.
    """

    def __init__(
        self,
        services: Services,
        broadcasters: Broadcasters,
        site: OriginPolicy,
        resolve: Resolve,
    ) -> None:
        space = self.space = services.space
        self.instance_id = services.instance_id
        self.channels = Channels(services.instance_id)
        self.broadcasters = broadcasters
        self._site = site
        self._resolve = resolve
        self.services = tuple(ServiceDescription(space.url(ROUTE, (kind,)), kind) for kind in CHANNEL_TYPES)
        self.description = f"{space.base}{WELL_KNOWN}/solid"
        self.link = Link(self.description, STORAGE_DESCRIPTION)
        """Link in every response (2.1)."""

    def service(self, kind: str) -> ServiceDescription | None:
        """Return the service that creates channels of a type."""
        return next((service for service in self.services if service.type == kind), None)

    def urls_of(self, kind: str, token: str) -> tuple[str, str]:
        """Return the URLs of a channel and of its notification source."""
        url = self.space.url(ROUTE, (kind, token))
        source = f"{url}/{SOURCE}"
        return url, source.replace("http", "ws", 1) if kind == WEBSOCKET else source

    async def create_channel(self, exchange: Exchange, service: ServiceDescription) -> Channel:
        """Create and return the requested channel. Raises Problems, and BodyError for an unreadable body."""
        check_profile(exchange.header("content-type"))
        media_type = exchange.media_type
        data = exchange.to_utf8(await read_body(exchange.request, limit=MAX_BYTES))
        wish = read_subscription(data, media_type, service.url, service.type, time.time_ns())
        resource, state = await self._topic(wish.topic, exchange.auth)
        place = partial(self.urls_of, service.type)
        return self.channels.open(wish, service.type, resource, state, place, exchange.auth)

    def websocket_receiver(self, scope: Scope) -> WebSocketReceiver:
        """Return the receiver of a new WebSocket. Raises Problems: 404 for an unknown path, 503 at capacity."""
        try:
            path = scope["raw_path"].decode("ascii").removeprefix(self.space.path.rstrip("/"))
            location = locate(path)
        except ValueError as error:
            raise Problem(400, f"{error}.") from error
        match location.segments:
            case (kind, token, name) if location.kind == ROUTE and kind == WEBSOCKET and name == SOURCE:
                self.broadcasters.require_capacity()
                return WebSocketReceiver(self.channels, self.broadcasters, channel_of(self, kind, token))
        raise Problem(404, NO_CHANNEL)

    async def _topic(self, url: str, auth: AuthContext) -> tuple[Resource, State]:
        """Return the topic of a channel, and its state. Raises a 422 Problem for a topic without a state."""
        scope, permissions = self._scope(url), auth.permissions
        exchange = Exchange(Request(scope), 0)
        exchange.auth = auth
        place = None if permissions.is_unrestricted else enforcement.location_of(scope, self.space)
        try:
            if not permissions.is_unrestricted:
                enforcement.require_path(permissions, "GET", place)
            resource = await _narrow(self._resolve(scope), exchange)
            await resource.prepare()
            if not permissions.is_unrestricted:
                enforcement.authorize(permissions, "GET", place, resource)
            return resource, await resource.state()
        except NotImplementedError as error:
            raise Problem(422, f"The topic {url} has no state that could change.") from error
        except (Problem, RosError) as error:
            problem = error if isinstance(error, Problem) else problem_of(error)
            problem = redact_problem(problem, permissions, place)
            if problem.status >= 500:
                raise problem from error
            detail = f"Cannot notify about the topic {url}: {problem.detail}"
            raise Problem(422, detail, extra=problem.quoted_members) from error

    def _scope(self, url: str) -> Scope:
        """Return a GET request for a URL under any origin of this server. Raises a 422 Problem for other URLs."""
        try:
            parts = urlsplit(url)
            origin = f"{parts.scheme}://{normalize_authority(parts.netloc, parts.scheme)}"
            raw_path, query = (quote(part, safe="/%:@!$&'()*+,;=~?-._").encode() for part in (parts.path, parts.query))
        except ValueError as error:
            raise Problem(422, f"The topic {url[:200]!r} is not a URL: {error}.") from error
        if origin not in self._site.origins or not raw_path.decode().startswith(self.space.path):
            raise Problem(422, f"The topic {url[:200]} is not on this server: choose a URL below {self.space.base}")
        return {
            "type": "http",
            "method": "GET",
            "path": unquote(parts.path),
            "raw_path": raw_path,
            "query_string": query,
            "headers": [],
        }


async def _narrow(resource: Resource, exchange: Exchange) -> Resource:
    """Return the variant that a request selects; a paged container is followed as a whole."""
    try:
        return await resource.select_variant(exchange)
    except Problem as problem:
        if problem.status != 303:
            raise
        return resource


def prefers_json(exchange: Exchange, offers: tuple[str, ...] = OFFERS) -> bool:
    """Whether JSON(-LD) is preferred, which is then written for clients without RDF support."""
    return exchange.preferred(FORMATS, offers) in (JSON_LD, JSON)


class DescribedResource(Resource):
    """Base class of resources with a document that is also available as compact JSON-LD."""

    def __init__(self, notifications: Notifications, url: str) -> None:
        super().__init__(notifications.space, url)
        self.notifications = notifications

    def document(self) -> Document:
        """Return the RDF of the resource."""
        raise NotImplementedError

    def members(self) -> Json | None:
        """Return the members of the compact JSON-LD object, or None to use the default JSON-LD."""
        return None

    async def state(self) -> State:
        return State(self.document)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        members = self.members()
        if members is None or not prefers_json(exchange):
            return None
        body = orjson.dumps(with_context(members))
        etag = ETag(f"{self.notifications.instance_id}-{digest(body)}", "jsonld")
        return bytes_response(exchange, body, JSON_LD, etag, resource_headers(self).items())

    def _headers(self) -> list[tuple[bytes, bytes]]:
        fixed_headers = {**resource_headers(self), "vary": "Accept"}
        return [(name.encode("latin-1"), value.encode("latin-1")) for name, value in fixed_headers.items()]


def _content(body: bytes) -> list[tuple[bytes, bytes]]:
    return [(b"content-type", JSON_LD.encode()), (b"content-length", b"%d" % len(body))]


class StorageDescription(DescribedResource):
    """`/.well-known/solid`: the storage description, with the subscription services."""

    kind = "Storage description"
    shape = "Subscriptions"
    title = "Notifications"
    item = PathItem("The subscription services", plain=OBJECT)

    def document(self) -> Document:
        return description_document(self.url, self.space.base, self.notifications.services)

    def members(self) -> Json:
        return description_members(self.url, self.space.base, self.notifications.services)


class WellKnownContainer(DescribedResource):
    """`/.well-known/`: container of the resources below it. RFC 8615 3 does not require one."""

    kind = title = "Well-known resources"
    shape = "Container"
    item = PathItem("The well-known resources")
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def document(self) -> Document:
        described = self.notifications.description
        return container_document(self.url, [described, f"{self.url}{THING}", f"{self.url}{VOID}"], self.title)


class ServiceContainer(WellKnownContainer):
    """`/channels/`: the subscription services. Channels are not listed: knowing the URL of one suffices to use it."""

    kind = title = "Subscription services"
    item = PathItem("The subscription services")

    def document(self) -> Document:
        return container_document(self.url, [one.url for one in self.notifications.services], self.title)


class SubscriptionService(DescribedResource):
    """`/channels/TYPE`: the subscription service that creates channels of one type."""

    kind = "Subscription service"
    shape = "SubscriptionService"
    accepts = {"POST": MEDIA_TYPES}  # noqa: RUF012
    takes_forms = False

    def __init__(self, notifications: Notifications, service: ServiceDescription) -> None:
        super().__init__(notifications, service.url)
        self.title = service.type
        self._service = service

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        subscribe = WriteMethod(
            "Subscribes to a topic; the response says where to receive notifications.",
            _SUBSCRIPTION,
            done=(201,),
            shows=OBJECT,
        )
        return PathItem(f"Creates channels: {self._service.type}", plain=OBJECT, writes={"POST": subscribe})

    def methods(self) -> frozenset[str]:
        return READ | {"POST"}

    def document(self) -> Document:
        return self._service.document()

    def members(self) -> Json:
        return self._service.members()

    def streams_body(self, exchange: Exchange) -> bool:
        return True

    async def post(self, exchange: Exchange) -> Answer:
        """Create a notification channel: 201, in the JSON-LD of the Solid Notifications Protocol by default."""
        channel = await self.notifications.create_channel(exchange, self._service)
        made = ChannelResource(self.notifications, channel)
        if not prefers_json(exchange, (JSON_LD, *OFFERS)):
            return CreatedAnswer(made.url, made, await made.state())
        body = orjson.dumps(with_context(channel.terms.members()))
        headers = [*made._headers(), (b"location", made.url.encode("ascii")), (b"cache-control", b"no-store")]
        return RawResponse(201, body, [*headers, *_content(body)])


class ChannelResource(DescribedResource):
    """`/channels/TYPE/TOKEN`: one channel. DELETE ends it."""

    kind = "Notification channel"
    shape = "Channel"
    title = "Notification channel"
    item = PathItem("A channel; deleting it stops its notifications", plain=OBJECT, methods=READ | {"DELETE"})
    is_cacheable = False

    def __init__(self, notifications: Notifications, channel: Channel) -> None:
        super().__init__(notifications, channel.terms.url)
        self._channel = channel

    def methods(self) -> frozenset[str]:
        return READ | {"DELETE"}

    def document(self) -> Document:
        return self._channel.terms.document()

    def members(self) -> Json:
        return self._channel.terms.members()

    async def delete(self, exchange: Exchange) -> Answer:
        """Close the channel; no more notifications are sent."""
        exchange.audit.add_step("end the channel", self.url)
        self.notifications.channels.close(self._channel)
        return Response(status_code=204)


class ChannelSourceResource(DescribedResource):
    """`/channels/TYPE/TOKEN/messages`: the notification source of a channel."""

    kind = "Notification source"
    item = PathItem(
        "The source of notifications: a WebSocket, or a response without end",
        (LINES, "text/turtle", "application/n-triples"),
        query=(),
        streams=False,
        methods=READ,
    )
    links = (RESOURCE,)
    is_cacheable = False

    def __init__(self, notifications: Notifications, channel: Channel) -> None:
        super().__init__(notifications, f"{channel.terms.url}/{SOURCE}")
        self._channel = channel

    async def custom_get(self, exchange: Exchange) -> Response:
        if self._channel.terms.type == WEBSOCKET:
            upgrade = {"Upgrade": "websocket", "Connection": "Upgrade"}
            raise Problem(426, f"Open a WebSocket at {self._channel.terms.receive_from}", headers=upgrade)
        headers = self._headers()
        if exchange.method == "HEAD":
            return RawResponse(200, b"", [*channel_headers(self._channel), *headers])
        self.notifications.broadcasters.require_capacity(exchange.request.client)
        return ChannelStream(self.notifications.channels, self.notifications.broadcasters, self._channel, headers)


def channel_route(location: Location, *, notifications: Notifications) -> Resource:
    """Return the resource under `/channels/`. Raises Problems: 404, or 308 for `/channels` without a slash."""
    space = notifications.space
    if not location.segments:
        url = space.container(ROUTE)
        if not location.is_container:
            raise permanent_redirect(url)
        return ServiceContainer(notifications, url)
    kind, *rest = location.segments
    service = notifications.service(kind)
    if service is not None and not location.is_container:
        match rest:
            case []:
                return SubscriptionService(notifications, service)
            case [token]:
                return ChannelResource(notifications, channel_of(notifications, kind, token))
            case [token, name] if name == SOURCE:
                return ChannelSourceResource(notifications, channel_of(notifications, kind, token))
    raise Problem(404, f"There is no such subscription service; {space.container(ROUTE)} lists them.")


def channel_of(notifications: Notifications, kind: str, token: str) -> Channel:
    """Return the channel of a type with a token. Raises a 404 Problem."""
    channel = notifications.channels.find(token)
    if channel.terms.type != kind:
        raise Problem(404, NO_CHANNEL)
    return channel


def fixed_resources(notifications: Notifications) -> Sequence[DescribedResource]:
    """Return the resources of notifications that never change."""
    container = notifications.space.container(ROUTE)
    services = (SubscriptionService(notifications, service) for service in notifications.services)
    return (
        WellKnownContainer(notifications, f"{notifications.space.base}{WELL_KNOWN}/"),
        StorageDescription(notifications, notifications.description),
        ServiceContainer(notifications, container),
        *services,
    )


def routes(notifications: Notifications, well_known: Route) -> Mapping[str, Route]:
    """Return the routes of notifications by first segment; `well_known` serves other paths below `/.well-known/`."""

    def known(location: Location) -> Resource:
        if not location.segments:
            url = f"{notifications.space.base}{WELL_KNOWN}/"
            if not location.is_container:
                raise permanent_redirect(url)
            return WellKnownContainer(notifications, url)
        if location.segments == ("solid",) and not location.is_container:
            return StorageDescription(notifications, notifications.description)
        return well_known(location)

    return {ROUTE: partial(channel_route, notifications=notifications), WELL_KNOWN: known}
