"""Containers of nodes, topics and services: the namespaces of their names (LDP 5, DESIGN section 3)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from rosld.adapters.model import Graph, names
from rosld.ontology.describe_containers import namespace_document
from rosld.ontology.namespaces import Kept, Members, members_of
from rosld.server.http.problem import Problem
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot

Namespaces = Mapping[tuple[str, ...], Members]

_namespaces: Kept[Mapping[str, object], Namespaces] = Kept(members_of)


def of_room(graph: Graph, room: str) -> Mapping[str, object]:
    """The things of one room by name."""
    rooms: Mapping[str, Mapping[str, object]] = {
        "nodes": graph.nodes,
        "topics": graph.topics,
        "services": graph.services,
        "parameters": graph.parameters,
    }
    return rooms[room]


def namespaces(graph: Graph, room: str) -> Namespaces:
    """The namespaces of one room with their members."""
    return _namespaces(of_room(graph, room))


def moved_to_namespace(robot: Robot, room: str, name: str) -> Problem | None:
    """308 to the container where a name is a namespace and nothing else; None where it is none."""
    path = names.segments(name)
    if path not in namespaces(robot.graph, room):
        return None
    url = robot.space.container(room, path)
    return Problem(308, f"It is at {url}", title="Moved", headers={"Location": url})


class NamespaceContainer(Resource):
    """A namespace of one kind of names: `/topics/`, `/topics/camera/`, ..."""

    kind = "Namespace"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot, room: str, namespace: tuple[str, ...]) -> None:
        super().__init__(robot.space.container(room, namespace))
        self.title = names.join(namespace) if namespace else room.capitalize()
        self.robot = robot
        self.room = room
        self.namespace = namespace

    async def state(self) -> State:
        members = namespaces(self.robot.graph, self.room).get(self.namespace)
        if members is None:
            raise self._missing()
        is_name = names.join(self.namespace) in of_room(self.robot.graph, self.room)
        describe = partial(namespace_document, self.room, self.namespace, members, self.robot.space, is_name=is_name)
        return self.robot.states.get(self.url, (members, is_name), lambda: State(describe))

    def _missing(self) -> Problem:
        """308 where the name is a leaf, else 404."""
        name = names.join(self.namespace)
        if name in of_room(self.robot.graph, self.room):
            leaf = self.robot.space.url(self.room, self.namespace)
            return Problem(308, f"It is at {leaf}", title="Moved", headers={"Location": leaf})
        return Problem(404, f"There is no namespace {name} under /{self.room}/.")
