"""The entry point `/`: the distributed application itself (paper, Table 1)."""

from __future__ import annotations

from collections.abc import Sequence

from rosld.ontology.describe_graph import ROOMS, entry_document
from rosld.server.html import Count, Csrf, EntryPage, Form, Notice, Site, render_entry
from rosld.server.http.link import Link
from rosld.server.ldp.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot
from rosld.server.writable import RESERVED

_FIRST = "What the robot is like now, and what it can do: values to read and to set, actions, links."


class EntryResource(Resource):
    """Where every client begins."""

    kind = "Robot"

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.space.base)
        self.robot = robot
        described = Link(f"{robot.space.base}openapi.json", "service-desc", type="application/openapi+json")  # RFC 8631
        self.links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER, described)

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        graph, space = self.robot.graph, self.robot.space
        numbers = {
            "topics": len(graph.topics),
            "services": len(graph.services),
            "nodes": len(graph.nodes),
            "parameters": len(graph.parameters),
            "bags": len(self.robot.adapter.recordings),
        }
        first = Count(ROOMS["resources"], None, space.container("resources"), _FIRST, first=True)
        counts = (
            first,
            *(Count(ROOMS[room], number, space.container(room)) for room, number in numbers.items() if number),
            *(
                Count(ROOMS[room], None, space.container(room))
                for room in ("types", "mappings", "data", "calls", "queries")
            ),
        )
        return render_entry(EntryPage(site, state.document, counts, self._example(), tuple(notices)))

    def _example(self) -> str | None:
        """The URL of a topic worth trying: a small one that somebody publishes."""
        topics = [topic for topic in self.robot.graph.topics.values() if topic.publishers and topic.type is not None]
        topics.sort(key=lambda topic: (topic.name in RESERVED, len(topic.name), topic.name))
        return self.robot.space.topic(topics[0].name) if topics else None

    async def state(self) -> State:
        graph = self.robot.graph
        system = self.robot.adapter.capabilities.system
        return self.robot.states.get(
            self.url, graph.revision, lambda: State(lambda: entry_document(graph, self.robot.space, system))
        )
