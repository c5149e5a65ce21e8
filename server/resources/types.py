"""Types and their shapes: `/types/PKG/msg/NAME` and `/shapes/PKG/msg/NAME`, within containers of packages.

Beside the packages of `/shapes/` lie `/shapes/mapping` and the like, and the limits that clients keep.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from functools import partial

from pyoxigraph import Triple

from rosld.adapters.model import Schema, TypeRef, halves_of
from rosld.ontology.describe_containers import type_container_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Location
from rosld.ontology.vocab import dcterms, rdf
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.policies import active_limits
from rosld.server.resources.context import IdentityKey, Robot
from rosld.server.resources.ldp.base import EXTRA_STATUSES
from rosld.server.resources.ldp.bodies import require_small
from rosld.server.resources.ldp.containers import ContainerResource
from rosld.server.resources.ldp.representation import all_members
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.limit_places import datatypes_of_limits, load_limited_types
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PAGE, PathItem, QueryParameter
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.session import used_types
from rosld.server.storage import Put, Record
from rosld.server.storage.record_documents import record_document
from rosld.shapes.data import data_shape, documents_shape, query_shape
from rosld.shapes.mapping import mapping_shape
from rosld.shapes.message import SHACL_SHACL, shape_document

DATA, DOCUMENTS, LIMITS, MAPPING, QUERY = "data", "documents", "limits", "mapping", "query"
SHAPES_GRAPHS = (DATA, DOCUMENTS, LIMITS, MAPPING, QUERY)
"""What lies below `/shapes/` beside the shapes of types, and what clients keep there."""

_HASH = QueryParameter("hash", "Which of several definitions of one name.")
_SUMMARIES = {
    "data": "The shapes of data",
    "documents": "The shapes of what documents say",
    "limits": "The limits in force",
    "mapping": "The shape of mapping documents",
    "query": "The shape of stored queries",
}


class TypeResource(Resource):
    """One message, service or action type; `?hash=` asks for one of several definitions."""

    kind = "Type"

    def __init__(self, robot: Robot, name: str, hash: str | None = None) -> None:
        super().__init__(robot.space.type(TypeRef(name, hash)))
        self.robot = robot
        self.ref = TypeRef(name, hash)

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Type"),)

    async def select_variant(self, exchange: Exchange) -> Resource:
        hash = exchange.query.get("hash")
        return self if hash is None else TypeResource(self.robot, self.ref.name, hash)

    async def current_methods(self) -> frozenset[str]:
        return await self.methods_if_there()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("One of the types", query=(FORMAT, _HASH))

    async def state(self) -> State:
        schema = await schema_of(self.robot, self.ref)
        variants = tuple(ref for ref in known_types(self.robot) if ref.name == self.ref.name)
        return self.robot.states.get_or_make(
            self.url,
            (IdentityKey(schema), variants),
            lambda: State(lambda: type_document(schema, self.robot.space, variants)),
        )


class ShapeResource(Resource):
    """The SHACL shape of one type."""

    kind = "Shape"

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.shape(name))
        self.robot = robot
        self.name = name

    async def current_methods(self) -> frozenset[str]:
        return await self.methods_if_there()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("One of the shapes")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (SHACL_SHACL,)

    async def state(self) -> State:
        schema = await schema_of(self.robot, TypeRef(self.name))
        return self.robot.states.get_or_make(
            self.url, IdentityKey(schema), lambda: State(lambda: shape_document(schema, self.robot.space))
        )


class ShapesGraphResource(Resource):
    """`/shapes/data`, `/shapes/documents`, `/shapes/limits`, ...: a shapes graph by itself."""

    kind = "Shape"

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.shape(name))
        self.robot = robot
        self.title = name

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(_SUMMARIES[self.title])

    def deny_reason(self, method: str) -> str:
        return _deny_reason(self.robot, self.url, method)

    async def current_methods(self) -> frozenset[str]:
        return await self.methods_if_there()

    @property
    def conforms_to(self) -> Sequence[str]:
        return (SHACL_SHACL,)

    async def state(self) -> State:
        if self.title == LIMITS:
            await load_limited_types(self.robot)
        key, describe = shapes_graph(self.robot, self.title)
        return self.robot.states.get_or_make(self.url, key, lambda: State(describe))


def shapes_graph(robot: Robot, name: str) -> tuple[object, Callable[[], Document]]:
    """One of SHAPES_GRAPHS: what tells whether it is the same as before, and what describes it."""
    url = robot.space.shape(name)
    if name != LIMITS:
        return name, partial(_SHAPES[name], url)
    datatypes, graph = datatypes_of_limits(robot), robot.limits.graph
    return (IdentityKey(robot.limits), datatypes), lambda: Document(url, (*graph, *datatypes))


_SHAPES: Mapping[str, Callable[[str], Document]] = {
    DATA: data_shape,
    DOCUMENTS: documents_shape,
    MAPPING: mapping_shape,
    QUERY: query_shape,
}


class TypeContainer(Resource):
    """`/types/` and `/shapes/`, their packages and kinds."""

    kind = "Types"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot, room: str, namespace: tuple[str, ...]) -> None:
        super().__init__(robot.space.container(room, namespace))
        self.robot = robot
        self.room = room
        self.namespace = namespace

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        of = ("", " of a package", " of a kind")[len(self.namespace)]
        return PathItem(f"{self.room.capitalize()}{of}")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Container"),)

    async def state(self) -> State:
        listed = sorted({ref.name for ref in known_types(self.robot)})
        below = child_names(listed, self.room, self.namespace)
        if self.namespace and not below:
            raise Problem(404, f"No type of {'/'.join(self.namespace)} is known.")
        return self.robot.states.get_or_make(
            self.url,
            below,
            lambda: State(lambda: type_container_document(self.room, self.namespace, below, self.robot.space)),
        )


async def schema_of(robot: Robot, ref: TypeRef) -> Schema:
    """The schema of a type or of one of the messages of a service or an action; raises UnknownType."""
    base, _, end = ref.name.rpartition("_")
    if any(part in ref.name and end in ends for part, ends in _HALVES.items()):
        whole = await robot.schemas.get(TypeRef(base, ref.hash))
        for half in halves_of(whole):
            if half.ref.name == ref.name:
                return half
    return await robot.schemas.get(ref)


_HALVES = {"/srv/": ("Request", "Response"), "/action/": ("Goal", "Result", "Feedback")}


def known_types(robot: Robot) -> Sequence[TypeRef]:
    """The types in use or met so far, each name and hash once."""
    return list(dict.fromkeys([*robot.adapter.known_types(), *used_types(robot.graph)]))


def child_names(listed: Sequence[str], room: str, namespace: tuple[str, ...]) -> tuple[str, ...]:
    """The names that a container of types or shapes shows, of those `listed` by the robot."""
    depth = len(namespace)
    below = tuple(name for name in listed if tuple(name.split("/"))[:depth] == namespace)
    return (*below, *SHAPES_GRAPHS) if room == "shapes" and not namespace else below


def type_route(robot: Robot, location: Location) -> Resource:
    """`/types/` and below."""
    if location.is_container or len(location.segments) < 3:
        return _container(robot, "types", location)
    return TypeResource(robot, "/".join(location.segments))


def shape_route(robot: Robot, location: Location) -> Resource:
    """`/shapes/` and below: shapes of types, and beside their packages the limits that clients keep."""
    if location.is_container and not location.segments:
        return LimitsContainer(robot, active_limits.ROUTE)
    if len(location.segments) == 1:
        name = location.segments[0]
        if name in SHAPES_GRAPHS and not location.is_container:
            return ShapesGraphResource(robot, name)
        if not location.is_container and name in _packages(robot):
            return PackageRedirect(robot, name)
        if not location.is_container:
            return stored_route(robot, location)
    if location.is_container or len(location.segments) < 3:
        return _container(robot, "shapes", location)
    return ShapeResource(robot, "/".join(location.segments))


class PackageRedirect(Resource):
    """`/shapes/PKG`: the shapes of a package are at the URL that ends in a slash, and nothing else has its name."""

    kind = "Shape"
    is_cacheable = False

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.shape(name))
        self.robot = robot

    def deny_reason(self, method: str) -> str:
        return _deny_reason(self.robot, self.url, method)

    async def select_variant(self, exchange: Exchange) -> Resource:
        if exchange.method in ("GET", "HEAD"):
            raise permanent_redirect(f"{self.url}/")
        return self


class LimitsContainer(ContainerResource):
    """`/shapes/`: the packages with the shapes of their types, and the limits that clients keep."""

    async def select_variant(self, exchange: Exchange) -> Resource:
        found = await super().select_variant(exchange)
        if type(found) is ContainerResource:
            return LimitsContainer(self.robot, self.path, found._parts, found._place)
        return found

    def is_taken(self, name: str) -> bool:
        return name in SHAPES_GRAPHS or name in _packages(self.robot) or super().is_taken(name)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("Shapes", query=(FORMAT, PAGE), also=EXTRA_STATUSES)

    async def state(self) -> State:
        kept = await super().state()
        listed = _generate(self.robot)
        is_here = self._parts.containment and (self._place is None or self._place.after == 0)
        more = tuple(one for one in listed.triples if _is_of(one, containment=is_here, minimal=self._parts.minimal))

        def describe() -> Document:
            return Document(kept.document.url, tuple(dict.fromkeys((*kept.document.triples, *more))))

        return self.robot.states.get_or_make(
            f"{self.url}?{self._place}#{self._parts.variant} with what is generated",
            (IdentityKey(kept), more),
            lambda: replace(kept, describe=describe, token=f"{kept.tag}-{digest(repr(more).encode())}", renderings={}),
        )

    async def with_triples(
        self, record: Record, triples: Sequence[Triple], expected: int | None, said: Set[Triple] = frozenset()
    ) -> Put:
        require_small(triples)
        own = set(_generate(self.robot).triples)
        return await super().with_triples(record, [one for one in triples if one not in own], expected, said)


def _is_of(triple: Triple, *, containment: bool, minimal: bool) -> bool:
    """Whether a part of the container tells this triple."""
    return minimal if triple.predicate in (dcterms.title, rdf.type) else containment


def _generate(robot: Robot) -> Document:
    """What `/shapes/` says of what nobody keeps there."""
    return type_container_document("shapes", (), child_names(_list(robot), "shapes", ()), robot.space)


def shapes_document(robot: Robot) -> Document:
    """What `/shapes/` says with all that is in it, as it is now."""
    record = robot.records.get(active_limits.ROUTE)
    assert record is not None
    members = [robot.space.base + member.path for member in all_members(robot, record)]
    kept = record_document(record, robot.space.container("shapes"), members, ())
    return Document(kept.url, tuple(dict.fromkeys((*kept.triples, *_generate(robot).triples))))


def _list(robot: Robot) -> list[str]:
    return sorted({ref.name for ref in known_types(robot)})


def _packages(robot: Robot) -> set[str]:
    return {ref.name.partition("/")[0] for ref in known_types(robot)}


def _deny_reason(robot: Robot, url: str, method: str) -> str:
    if robot.settings.read_only:
        return "This server is read-only."
    room = robot.space.container("shapes")
    return f"{url} is the server's own and does not answer {method}: limits may be kept at {room}NAME, by another name."


def _container(robot: Robot, room: str, location: Location) -> Resource:
    if not location.is_container:
        url = robot.space.container(room, location.segments)
        raise permanent_redirect(url)
    return TypeContainer(robot, room, location.segments)
