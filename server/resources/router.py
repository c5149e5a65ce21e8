"""From a path to its resource: one line a room."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeAlias

from starlette.types import Scope

from rosld.adapters.model import names
from rosld.ontology.urls import Location, locate
from rosld.server.html import StoredQuery
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.layout import path_of
from rosld.server.ldp.pages import Pages
from rosld.server.ldp.resource import Resource, moved
from rosld.server.resources.bags import bag_room
from rosld.server.resources.calls import CallContainer
from rosld.server.resources.complex import ComplexResource
from rosld.server.resources.entry import EntryResource
from rosld.server.resources.files import FILES
from rosld.server.resources.kept.room import kept_room
from rosld.server.resources.members import MemberResource
from rosld.server.resources.namespaces import NamespaceContainer
from rosld.server.resources.nodes import NodeResource
from rosld.server.resources.ontology import OntologyResource
from rosld.server.resources.openapi import OpenApiResource
from rosld.server.resources.parameters import ParameterResource, ParameterTree
from rosld.server.resources.queries import query_room
from rosld.server.resources.services import CallResource, ServiceResource
from rosld.server.resources.sparql import SparqlResource
from rosld.server.resources.things import RobotThing
from rosld.server.resources.topics import TopicResource
from rosld.server.resources.types import shape_room, type_room
from rosld.server.robot import Robot
from rosld.server.sparql.endpoint import QueryService
from rosld.server.sparql.stored import StoredQuery as StoredQueryText
from rosld.server.sparql.stored import shipped

Room: TypeAlias = Callable[[Robot, Location], Resource]
_MOST = 8192


def _named(kind: str, leaf: Callable[[Robot, str], Resource]) -> Room:
    """A room of things with ROS names: leaves, and the containers of their namespaces."""

    def room(robot: Robot, location: Location) -> Resource:
        if location.is_container:
            return NamespaceContainer(robot, kind, location.segments)
        if not location.segments:
            raise moved(robot.space.container(kind))
        return leaf(robot, location.name)

    return room


def _parameters(robot: Robot, location: Location) -> Resource:
    if location.is_container:
        return ParameterTree(robot, location.segments)
    if not location.segments:
        raise moved(robot.space.container("parameters"))
    return ParameterResource(robot, names.join(location.segments))


def _resources(robot: Robot, location: Location) -> Resource:
    name = location.name
    if location.is_container:
        return ComplexResource(robot, path_of(location.segments))
    if not location.segments:
        raise moved(robot.space.container("resources"))
    return MemberResource(robot, name)


def _well_known(robot: Robot, location: Location) -> Resource:
    if location.segments != ("wot",) or location.is_container:
        raise Problem(404, f"Nothing else is well known here than {robot.space.base}.well-known/wot")
    return RobotThing(robot)


def _calls(robot: Robot, location: Location) -> Resource:
    if location.is_container and not location.segments:
        return CallContainer(robot)
    if not location.segments:
        raise moved(robot.space.container("calls"))
    if len(location.segments) > 1 or location.is_container:
        raise Problem(404, "A call lies directly under /calls/.")
    return CallResource(robot, location.segments[0])


def _single(make: Callable[[Robot], Resource]) -> Room:
    def room(robot: Robot, location: Location) -> Resource:
        if location.segments or (location.is_container and location.kind):
            raise Problem(404, f"There is nothing below /{location.kind}.")
        return make(robot)

    return room


ROOMS: Mapping[str, Room] = {
    "": _single(EntryResource),
    "nodes": _named("nodes", NodeResource),
    "topics": _named("topics", TopicResource),
    "services": _named("services", ServiceResource),
    "calls": _calls,
    "parameters": _parameters,
    "types": type_room,
    "shapes": shape_room,
    "bags": bag_room,
    "resources": _resources,
    "data": kept_room,
    "mappings": kept_room,
    ".well-known": _well_known,
    "ontology": _single(OntologyResource),
} | {name: _single(make) for name, make in FILES.items()}


def _sparql_rooms(
    robot: Robot, service: QueryService, pages: Pages, queries: Mapping[str, StoredQueryText]
) -> Mapping[str, Room]:
    """The rooms that ask queries."""
    examples = [StoredQuery(robot.space.query(one.name), one.name, one.purpose, one.text) for one in queries.values()]
    endpoint = SparqlResource(robot, service, pages, examples)
    return {
        "sparql": _single(lambda robot: endpoint),
        "queries": partial(query_room, queries=queries, service=service, pages=pages),
    }


class Router:
    """Resolves paths; the resources of the last few thousand are kept, as they hold no state of their own."""

    def __init__(self, robot: Robot, service: QueryService, pages: Pages) -> None:
        self._robot = robot
        queries = shipped()
        described = OpenApiResource(robot, queries, self.at)
        self._rooms = {
            **ROOMS,
            **_sparql_rooms(robot, service, pages, queries),
            "openapi.json": _single(lambda robot: described),
        }
        self._base = robot.space.path.rstrip("/")
        self._kept: dict[bytes, Resource] = {}

    def add(self, rooms: Mapping[str, Room]) -> None:
        """Add rooms, in place of those of the same names."""
        self._rooms.update(rooms)

    def resolve(self, scope: Scope) -> Resource:
        """The resource at the path of a request; raises Problems: 400 malformed, 404 no such room, 308 moved."""
        raw: bytes = scope["raw_path"]
        resource = self._kept.get(raw)
        if resource is None:
            resource = self._find(raw)
            if not resource.lasting:
                return resource
            if len(self._kept) >= _MOST:
                self._kept.pop(next(iter(self._kept)))
            self._kept[raw] = resource
        return resource

    def _find(self, raw: bytes) -> Resource:
        try:
            return self.at(raw.decode("ascii").removeprefix(self._base))
        except UnicodeDecodeError as error:
            raise Problem(400, "The path is not ASCII: percent-encode it.") from error
        except ValueError as error:
            raise Problem(400, f"{error}.") from error

    def at(self, path: str) -> Resource:
        """The resource at a path below the base; raises Problems (404, 308), ValueError where it is malformed."""
        location = locate(path)
        room = self._rooms.get(location.kind)
        if room is None:
            raise Problem(404, f"There is nothing at {path}; begin at {self._robot.space.base}")
        return room(self._robot, location)
