"""Containers of nodes, topics, services and actions: the namespaces of their names, with brief members (LDP 5)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TypeVar

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.adapters.base import Capabilities
from rosld.adapters.model import Action, Graph, Node, Parameter, Service, Topic, freeze, names
from rosld.ontology.describe_graph import namespace_document, namespace_title
from rosld.ontology.describe_views import MemberOutline, member_triples
from rosld.ontology.document import Document
from rosld.ontology.names import IdentityCache, Members, members_of
from rosld.ontology.urls import Space, decode_segment, encode_segment
from rosld.ontology.vocab import ros
from rosld.server.html.page import Cell, MemberColumns, Thumbnail
from rosld.server.html.values import brief_text
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.brief_value import LatestValue
from rosld.server.pictures.picture_cache import OCCUPANCY_GRID
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.paging import (
    LdpPage,
    PagedContainer,
    PagePosition,
    page_of_names,
    page_query,
    parse_named_position,
    require_page,
)
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.rest.state import State

_THUMBNAIL_WIDTH = 192
"""Width in pixels; thumbnails are drawn half as wide, for high-density screens."""


def _outline(
    latest_of: Callable[[str], LatestValue | None], things: Mapping[str, object], name: str, url: str
) -> MemberOutline:
    match things.get(name):
        case Topic() as thing:
            latest = latest_of(name)
            rate, value = (None, None) if latest is None else (latest.rate, latest.json)
            return MemberOutline(url, ros.Topic, name, tuple(thing.types), rate, value)
        case Service() as thing:
            return MemberOutline(url, ros.Service, name, () if thing.type is None else (thing.type.name,))
        case Action() as thing:
            return MemberOutline(url, ros.Action, name, () if thing.type is None else (thing.type.name,))
        case Node():
            return MemberOutline(url, ros.Node, name)
    return MemberOutline(url, None, name)


def _namespace_outline(space: Space, route: str, path: tuple[str, ...]) -> MemberOutline:
    return MemberOutline(space.container(route, path), None, names.join(path), label=namespace_title(route, path))


def topic_cells(topic: Topic, latest: LatestValue | None, space: Space) -> tuple[Cell, ...]:
    """Return the cells of a topic: type, latest value and rate if available, numbers of publishers and subscribers."""
    kind = NamedNode(space.class_of(topic.type.name)) if topic.type else ", ".join(ref.name for ref in topic.types)
    value = "" if latest is None or latest.json is None else brief_text(latest.json)
    picture = None if latest is None else thumbnail(latest, space.topic(topic.name))
    rate = "" if latest is None or latest.rate is None else f"{latest.rate:.3g} Hz"
    return (kind, picture or value, rate, str(len(topic.publishers)), str(len(topic.subscribers)))


def thumbnail(latest: LatestValue, url: str) -> Thumbnail | None:
    """Return the thumbnail of the topic at a URL, or None if its latest value is not a drawable picture.

    The thumbnail's URL changes with each message, so that pages fetch it again only then.
    """
    if latest.picture is None:
        return None
    format = "png" if latest.picture.type_name == OCCUPANCY_GRID else "jpeg"  # maps are largely transparent
    query = f"format={format}&width={_THUMBNAIL_WIDTH}&v={latest.picture.sequence}"
    return Thumbnail(url, query, "" if latest.json is None else brief_text(latest.json))


def service_cells(service: Service, space: Space) -> tuple[Cell, ...]:
    """Return the cells of a service: its type and who provides it."""
    kind = NamedNode(space.class_of(service.type.name)) if service.type else ""
    return (kind, NamedNode(space.node(service.providers[0])) if service.providers else "")


def action_cells(action: Action, space: Space) -> tuple[Cell, ...]:
    """Return the cells of an action: its type and who serves it."""
    kind = NamedNode(space.class_of(action.type.name)) if action.type else ""
    return (kind, NamedNode(space.node(action.servers[0])) if action.servers else "")


NB = TypeVar("NB", bound="NamespaceBase")
Namespaces = Mapping[tuple[str, ...], Members]

MAX_ROWS = 1000
"""Maximum number of rows in the table of a namespace's page."""

HIDDEN = "hidden=true"
"""Query string of listings with hidden names."""
_HIDDEN = QueryParameter("hidden", "Whether to include names with a segment that begins with `_`.", {"type": "boolean"})

_VALUES_NOTE = "Values and rates are shown for subscribed topics: a list does not subscribe."
_V = TypeVar("_V")
_namespaces: IdentityCache[Mapping[str, object], Namespaces] = IdentityCache(members_of, 24)


def things_of(graph: Graph, route: str) -> Mapping[str, object]:
    """Return the things of one route by name."""
    routes: Mapping[str, Mapping[str, object]] = {
        "nodes": graph.nodes,
        "topics": graph.topics,
        "services": graph.services,
        "actions": graph.actions,
        "parameters": graph.parameters,
    }
    return routes[route]


def namespaces(graph: Graph, route: str) -> Namespaces:
    """Return the namespaces of one route with their members."""
    return _namespaces(things_of(graph, route))


def is_of_hidden(parameter: Parameter) -> bool:
    """Whether a parameter belongs to a hidden node."""
    return parameter.node is not None and names.is_hidden(parameter.node)


def _filtered(predicate: Callable[[str, _V], bool], things: Mapping[str, _V]) -> Mapping[str, _V]:
    found = {name: thing for name, thing in things.items() if predicate(name, thing)}
    return things if len(found) == len(things) else freeze(found)


def _unhidden(graph: Graph) -> Graph:
    """Return the graph without hidden names; parameters are hidden with their nodes."""

    def shown(things: Mapping[str, _V]) -> Mapping[str, _V]:
        return _filtered(lambda name, _: not names.is_hidden(name), things)

    return dataclasses.replace(
        graph,
        nodes=shown(graph.nodes),
        topics=shown(graph.topics),
        services=shown(graph.services),
        actions=shown(graph.actions),
        parameters=_filtered(lambda _, one: not is_of_hidden(one), graph.parameters),
    )


_listed: IdentityCache[Graph, Graph] = IdentityCache(_unhidden)


def listed_graph(graph: Graph, capabilities: Capabilities) -> Graph:
    """Return the graph for listings: without hidden names, if this kind of system has them."""
    return _listed(graph) if capabilities.hidden_names else graph


LISTING_PARAMETERS = (FORMAT, _HIDDEN)
"""Query parameters of a listing of names; `hidden` has no effect on systems without hidden names."""


def with_hidden(url: str) -> str:
    """Return the URL of a container that lists hidden members, too."""
    return f"{url}?{HIDDEN}"


def listing_query(place: PagePosition | None, *, hidden: bool) -> str:
    """Return the query string of a listing: of the page at `place` or the whole, with or without `hidden` members."""
    parts = [HIDDEN] if hidden else []
    return "&".join(parts if place is None else [*parts, page_query(place.token)])


class ListedNamespace(Struct, frozen=True, eq=False):
    """A namespace of one route as listed in one graph. `hidden`: including hidden members."""

    graph: Graph
    capabilities: Capabilities
    route: str
    namespace: tuple[str, ...]
    hidden: bool = False

    @property
    def members(self) -> Members | None:
        """The listed members; None if there is no such namespace.

        Hidden members are listed on request, and always within a hidden namespace.
        """
        every = self._every_member()
        if every is None or self.hidden or names.is_hidden(names.join(self.namespace)):
            return every
        return namespaces(listed_graph(self.graph, self.capabilities), self.route).get(self.namespace, Members())

    @property
    def leaves_out(self) -> bool:
        """Whether hidden members are omitted."""
        return self.members != self._every_member()

    @property
    def is_name(self) -> bool:
        """Whether something has the name of the namespace itself."""
        return names.join(self.namespace) in things_of(self.graph, self.route)

    def document(self, space: Space, members: Members) -> Document:
        """Return the document with these members, and a link to the whole listing if hidden ones are omitted."""
        whole = with_hidden(space.container(self.route, self.namespace)) if self.leaves_out else None
        return namespace_document(self.route, self.namespace, members, space, is_name=self.is_name, whole=whole)

    def _every_member(self) -> Members | None:
        return namespaces(self.graph, self.route).get(self.namespace)


def count_members(members: Members) -> int:
    """Return the number of names and nested namespaces in a namespace."""
    return len(members.leaves) + len(members.namespaces)


def member_keys(members: Members) -> list[str]:
    """Return the last part of each member's URL, in the order of pages."""
    return sorted([*map(encode_segment, members.leaves), *(f"{encode_segment(one)}/" for one in members.namespaces)])


def members_from_keys(ends: Sequence[str]) -> Members:
    """Return the members with these last parts of URLs: the inverse of `member_keys`."""
    leaves = tuple(sorted(decode_segment(end) for end in ends if not end.endswith("/")))
    return Members(leaves, tuple(sorted(decode_segment(end[:-1]) for end in ends if end.endswith("/"))))


def redirect_to_namespace(space: Space, graph: Graph, route: str, name: str) -> Problem | None:
    """Return a redirect (308) to the container of a name that is a namespace, or None if it is not."""
    path = names.segments(name)
    if path not in namespaces(graph, route):
        return None
    return permanent_redirect(space.container(route, path))


class NamespaceBase(PagedContainer, SessionResource):
    """Base class of the containers of one kind of names, with or without hidden members."""

    links_offer = True
    route: str
    namespace: tuple[str, ...]
    _hidden = False

    @property
    def variant_key(self) -> Hashable:
        return self._place, self._hidden

    @property
    def query(self) -> str:
        return listing_query(self._place, hidden=self._hidden)

    @property
    def _sequence(self) -> str:
        return with_hidden(self.url) if self._hidden else self.url

    def _listed(self) -> ListedNamespace:
        """Return the listed namespace of the current graph."""
        return ListedNamespace(
            self.session.graph, self.session.adapter.capabilities, self.route, self.namespace, hidden=self._hidden
        )

    def requested(self: NB, exchange: Exchange) -> NB:
        """Return the variant for the requested page, with hidden members if requested."""
        token = exchange.query.get("page")
        place = None if token is None else parse_named_position(token)
        return self.variant(_place=place, _hidden=exchange.query_flag("hidden"))

    def ldp_page(self, place: PagePosition) -> LdpPage | None:
        members = self._listed().members
        return None if members is None else page_of_names(self._sequence, place, member_keys(members))[0]


class NamespaceContainer(NamespaceBase):
    """A namespace of one kind of names: `/topics/`, `/topics/camera/`, ...; paged if it has many members."""

    kind = "Namespace"
    is_found_by_state = True
    shape = "Container"

    def __init__(self, services: Services, route: str, namespace: tuple[str, ...]) -> None:
        super().__init__(services, services.space.container(route, namespace))
        self.title = names.join(namespace) if namespace else route.capitalize()
        self.latest_values = services.latest_values
        self.route = route
        self.namespace = namespace
        self.item = PathItem(self.route.capitalize(), query=LISTING_PARAMETERS, is_paged=True)

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the page `?page=`; redirect to the first of many pages (303)."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        target = self.requested(exchange)
        if target._place is None:
            require_page(exchange, self.url, count_members(target._members(target._listed())))
        return target

    async def state(self) -> State:
        now = self._listed()
        members = self._members(now)
        page, part = (None, members) if self._place is None else self._page(self._place, members)
        outlines = self._outlines(now, part, self.latest_values.of_topic)
        values = self._values_below()
        version = (members, now.is_name, outlines, values, now.graph.revision)

        def make() -> State:
            document = self._document(now, part, outlines)
            if page is None:
                return State(lambda: document, token=token)
            headers = page.headers(self.links)
            return State(lambda: page.add_to(document), token=token, part=page.part, headers=headers)

        token = digest(repr((members, now.is_name, now.leaves_out, outlines, values)).encode("utf-8", "replace"))
        return self.states.get_or_make(self._sequence if page is None else page.url, version, make)

    def outline(self) -> tuple[Hashable, Callable[[], Document]]:
        """Return a token that changes with the description, and a function for the description without values."""
        now = self._listed()
        members = self._members(now)
        outlines = self._outlines(now, members, lambda name: None)
        return (members, now.is_name, now.leaves_out, outlines), lambda: self._document(now, members, outlines)

    def _outlines(
        self, now: ListedNamespace, part: Members, latest_of: Callable[[str], LatestValue | None]
    ) -> tuple[MemberOutline, ...]:
        """Return outlines of these members: names, types, latest values of topics."""
        things, space = things_of(now.graph, self.route), self.space
        leaves = ((*self.namespace, leaf) for leaf in part.leaves)
        below = ((*self.namespace, inner) for inner in part.namespaces)
        return (
            *(_outline(latest_of, things, names.join(path), space.url(self.route, path)) for path in leaves),
            *(_namespace_outline(space, self.route, path) for path in below),
        )

    def _values_below(self) -> Sequence[tuple[str, LatestValue | None]]:
        """Return the cached values of all topics below, which are part of the page's version."""
        if self.route != "topics":
            return ()
        prefix, values = "".join(f"/{part}" for part in self.namespace) + "/", self.latest_values
        below = (name for name in self.session.topics.subscribed() if name.startswith(prefix))
        return tuple((name, values.of_topic(name)) for name in below)

    def _document(self, now: ListedNamespace, members: Members, outlines: Sequence[MemberOutline]) -> Document:
        """Return the document of the namespace with outlines of its members."""
        document = now.document(self.space, members)
        outlined = (triple for outline in outlines for triple in member_triples(outline, self.space))
        return replace(document, triples=(*document.triples, *outlined))

    def _members(self, now: ListedNamespace) -> Members:
        """Return the members. Raises a Problem if there is no such namespace."""
        members = now.members
        if members is None:
            raise self._missing(now)
        return members

    def _page(self, place: PagePosition, members: Members) -> tuple[LdpPage, Members]:
        """Return a page and its members."""
        page, page_keys = page_of_names(self._sequence, place, member_keys(members))
        return page, members_from_keys(page_keys)

    def listing(self) -> MemberColumns | None:
        """Return everything below on this page, with types and endpoints."""
        whole = self._hidden or names.is_hidden(names.join(self.namespace))
        now, space = self._listed(), self.space
        graph, members = now.graph if whole else listed_graph(now.graph, now.capabilities), now.members
        if self.route == "topics":
            found, total = self._below(graph.topics, members)
            topics = {name: graph.topics[name] for name in found}
            latest = {name: self.latest_values.of_topic(name) for name in topics}
            return MemberColumns(
                ("type", "latest value", "rate", "publishers", "subscribers"),
                {space.topic(name): topic_cells(topic, latest[name], space) for name, topic in topics.items()},
                total,
                note=_VALUES_NOTE if None in latest.values() else "",
            )
        if self.route == "services":
            found, total = self._below(graph.services, members)
            cells = {space.service(name): service_cells(graph.services[name], space) for name in found}
            return MemberColumns(("type", "provider"), cells, total)
        if self.route == "actions":
            found, total = self._below(graph.actions, members)
            cells = {space.action(name): action_cells(graph.actions[name], space) for name in found}
            return MemberColumns(("type", "server"), cells, total)
        return None if self._place is None or members is None else MemberColumns(total=count_members(members))

    def _below(self, known: Mapping[str, object], members: Members | None) -> tuple[list[str], int]:
        """Return the sorted names to list on this page, at most `MAX_ROWS`, and the total number of names."""
        prefix = "".join(f"/{part}" for part in self.namespace) + "/"
        below = sorted(name for name in known if name.startswith(prefix))
        total = len(below)
        if self._place is not None and members is not None:
            part = self._page(self._place, members)[1]
            leaves, inner = set(part.leaves), set(part.namespaces)
            rests = ((name, name[len(prefix) :].partition("/")) for name in below)
            below = [name for name, (part, slash, _) in rests if part in (inner if slash else leaves)]
        return below[:MAX_ROWS], total

    def _missing(self, now: ListedNamespace) -> Problem:
        """Return a 308 redirect if the name is a leaf, else a 404 Problem."""
        if now.is_name:
            leaf = self.space.url(self.route, self.namespace)
            return permanent_redirect(leaf)
        return Problem(404, f"There is no namespace {names.join(self.namespace)} under /{self.route}/.")
