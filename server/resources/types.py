"""Types and their shapes: `/types/PKG/msg/NAME` and `/shapes/PKG/msg/NAME`, within containers of packages.

`/shapes/mapping` is there too: the shape of mapping documents.
"""

from __future__ import annotations

from collections.abc import Sequence

from rosld.adapters.model import Schema, ServiceSchema, TypeRef
from rosld.ontology.describe_containers import type_container_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Location
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource, moved
from rosld.server.ldp.state import State
from rosld.server.robot import Robot, Same, used_types
from rosld.shapes.data import data_shape
from rosld.shapes.mapping import mapping_shape
from rosld.shapes.message import shape_document

DATA, LIMITS, MAPPING = "data", "limits", "mapping"
"""What lies below `/shapes/` beside the shapes of types: what constrains kept data, limits, mapping documents."""
WHOLE = (DATA, LIMITS, MAPPING)


class TypeResource(Resource):
    """One message or service type; `?hash=` asks for one of several definitions."""

    kind = "Type"

    def __init__(self, robot: Robot, name: str, hash: str | None = None) -> None:
        super().__init__(robot.space.type(TypeRef(name, hash)))
        self.robot = robot
        self.ref = TypeRef(name, hash)

    async def narrowed(self, exchange: Exchange) -> Resource:
        hash = exchange.query.get("hash")
        return self if hash is None else TypeResource(self.robot, self.ref.name, hash)

    async def state(self) -> State:
        schema = await schema_of(self.robot, self.ref)
        variants = tuple(ref for ref in known_types(self.robot) if ref.name == self.ref.name)
        return self.robot.states.get(
            self.url,
            (Same(schema), variants),
            lambda: State(lambda: type_document(schema, self.robot.space, variants)),
        )


class ShapeResource(Resource):
    """The SHACL shape of one type."""

    kind = "Shape"

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.shape(name))
        self.robot = robot
        self.name = name

    async def state(self) -> State:
        schema = await schema_of(self.robot, TypeRef(self.name))
        return self.robot.states.get(
            self.url, Same(schema), lambda: State(lambda: shape_document(schema, self.robot.space))
        )


class WholeShapeResource(Resource):
    """`/shapes/data`, `/shapes/limits` and `/shapes/mapping`: a shapes graph by itself."""

    kind = "Shape"

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.shape(name))
        self.robot = robot
        self.title = name

    async def state(self) -> State:
        return self.robot.states.get(self.url, 0, lambda: State(lambda: whole_shape(self.robot, self.title)))


def whole_shape(robot: Robot, name: str) -> Document:
    """One of the shapes graphs of WHOLE."""
    url = robot.space.shape(name)
    if name == LIMITS:
        return Document(url, robot.limits.graph)
    return mapping_shape(url) if name == MAPPING else data_shape(url)


class TypeContainer(Resource):
    """`/types/` and `/shapes/`, their packages and kinds."""

    kind = "Types"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot, room: str, namespace: tuple[str, ...]) -> None:
        super().__init__(robot.space.container(room, namespace))
        self.robot = robot
        self.room = room
        self.namespace = namespace

    async def state(self) -> State:
        listed = sorted({ref.name for ref in known_types(self.robot)})
        below = names_below(listed, self.room, self.namespace)
        if self.namespace and not below:
            raise Problem(404, f"No type of {'/'.join(self.namespace)} is known.")
        return self.robot.states.get(
            self.url,
            below,
            lambda: State(lambda: type_container_document(self.room, self.namespace, below, self.robot.space)),
        )


async def schema_of(robot: Robot, ref: TypeRef) -> Schema:
    """The schema of a type or of one half of a service; raises UnknownType."""
    base, _, half = ref.name.rpartition("_")
    if "/srv/" in ref.name and half in ("Request", "Response"):
        service = await robot.schemas.find(TypeRef(base, ref.hash))
        if isinstance(service, ServiceSchema):
            return service.request if half == "Request" else service.response
    return await robot.schemas.find(ref)


def known_types(robot: Robot) -> Sequence[TypeRef]:
    """The types in use or met so far, each name and hash once."""
    return list(dict.fromkeys([*robot.adapter.known_types(), *used_types(robot.graph)]))


def names_below(listed: Sequence[str], room: str, namespace: tuple[str, ...]) -> tuple[str, ...]:
    """The names that a container of types or shapes shows, of those `listed` by the robot."""
    depth = len(namespace)
    below = tuple(name for name in listed if tuple(name.split("/"))[:depth] == namespace)
    return (*below, *WHOLE) if room == "shapes" and not namespace else below


def type_room(robot: Robot, location: Location) -> Resource:
    """`/types/` and below."""
    if location.is_container or len(location.segments) < 3:
        return _container(robot, "types", location)
    return TypeResource(robot, "/".join(location.segments))


def shape_room(robot: Robot, location: Location) -> Resource:
    """`/shapes/` and below."""
    if len(location.segments) == 1 and location.segments[0] in WHOLE and not location.is_container:
        return WholeShapeResource(robot, location.segments[0])
    if location.is_container or len(location.segments) < 3:
        return _container(robot, "shapes", location)
    return ShapeResource(robot, "/".join(location.segments))


def _container(robot: Robot, room: str, location: Location) -> Resource:
    if not location.is_container:
        url = robot.space.container(room, location.segments)
        raise moved(url)
    return TypeContainer(robot, room, location.segments)
