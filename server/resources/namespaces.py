"""Containers of nodes, topics and services: the namespaces of their names (LDP 5)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from pyoxigraph import NamedNode

from rosld.adapters.model import Graph, Service, Topic, names
from rosld.ontology.describe_containers import namespace_document
from rosld.ontology.namespaces import Kept, Members, members_of
from rosld.ontology.urls import Space
from rosld.server.html import Listing
from rosld.server.html.page import Cell
from rosld.server.http.problem import Problem
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource, moved
from rosld.server.ldp.state import State
from rosld.server.robot import Robot

Namespaces = Mapping[tuple[str, ...], Members]

MOST_ROWS = 1000
"""Rows of a table on the page of a namespace."""

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
    return moved(url)


def _topic_cells(topic: Topic, space: Space) -> tuple[Cell, ...]:
    kind = NamedNode(space.class_of(topic.type.name)) if topic.type else ", ".join(ref.name for ref in topic.types)
    return (kind, str(len(topic.publishers)), str(len(topic.subscribers)))


def _service_cells(service: Service, space: Space) -> tuple[Cell, ...]:
    kind = NamedNode(space.class_of(service.type.name)) if service.type else ""
    return (kind, NamedNode(space.node(service.providers[0])) if service.providers else "")


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
        version = (members, is_name, self.robot.graph.revision)  # the page tells of what lies below, too
        return self.robot.states.get(self.url, version, lambda: State(describe))

    def listing(self) -> Listing | None:
        """Everything below, with types and endpoints."""
        prefix = "".join(f"/{part}" for part in self.namespace) + "/"
        graph, space = self.robot.graph, self.robot.space
        if self.room == "topics":
            topics = [topic for name, topic in sorted(graph.topics.items()) if name.startswith(prefix)][:MOST_ROWS]
            return Listing(
                ("type", "publishers", "subscribers"),
                {space.topic(topic.name): _topic_cells(topic, space) for topic in topics},
            )
        if self.room == "services":
            services = [one for name, one in sorted(graph.services.items()) if name.startswith(prefix)][:MOST_ROWS]
            return Listing(
                ("type", "provider"), {space.service(one.name): _service_cells(one, space) for one in services}
            )
        return None

    def _missing(self) -> Problem:
        """308 where the name is a leaf, else 404."""
        name = names.join(self.namespace)
        if name in of_room(self.robot.graph, self.room):
            leaf = self.robot.space.url(self.room, self.namespace)
            return moved(leaf)
        return Problem(404, f"There is no namespace {name} under /{self.room}/.")
