"""`/status`: how promptly the server itself answers, whether it sees the robot, and what is wrong with its storage."""

from __future__ import annotations

from collections.abc import Callable

import orjson
from pyoxigraph import NamedNode

from rosld.adapters.model import Graph, Stale
from rosld.ontology.describe_graph import ServerProblems, graph_state, problem_statements
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, double, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.hypermedia.json_schema import TEXT, JsonSchema, MessageSchemas, nullable
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.runtime.watchdog import Pauses, Watchdog

ROUTE = "status"


class StatusResource(Resource):
    """The pauses of the event loop, the state of the robot's graph, and the problems of storage."""

    kind = "Server status"
    shape = "ServerStatus"

    def __init__(
        self,
        space: Space,
        graph: Callable[[], Graph],
        problems: Callable[[], ServerProblems],
        watchdog: Watchdog,
    ) -> None:
        super().__init__(space, space.base + ROUTE)
        self._graph = graph
        self._problems = problems
        self._watchdog = watchdog

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        seconds: JsonSchema = {"type": "number", "minimum": 0}
        told: JsonSchema = dict.fromkeys(("longestPause", "longestWork", "recentPause"), seconds)
        told = {**told, **dict.fromkeys(("longestPauseEnd", "longestPauseCode", "longestWorkCode"), nullable(TEXT))}
        told["robot"] = {
            "type": "object",
            "properties": {
                "state": {"enum": ["Live", "Stale"]},
                "staleSince": nullable(TEXT),
                "reason": nullable(TEXT),
            },
        }
        told["interruptedHold"] = {"type": "array", "items": TEXT}
        summary = "How promptly the server itself answers, whether it sees the robot, what is wrong with its storage"
        return PathItem(summary, plain={"type": "object", "properties": told})

    async def state(self) -> State:
        pauses, problems, graph = self._watchdog.pauses, self._problems(), self._graph()
        return State(
            lambda: status_document(self.space, pauses, graph, problems), lambda: _plain(pauses, graph, problems)
        )


def status_document(space: Space, pauses: Pauses, graph: Graph, problems: ServerProblems) -> Document:
    """Return the RDF of a server's status; times are in seconds."""
    longest, status = pauses.longest, NamedNode(space.base + ROUTE)
    return Document(
        status.value,
        (
            *triples_about(
                status,
                (rdf.type, ros.ServerStatus),
                *RDF_SOURCE,
                (ros.longestPause, double(round(longest.seconds, 4))),
                (ros.longestPauseEnd, date_time_literal(longest.ended_ns)),
                (ros.longestPauseCode, text(longest.code)),
                (ros.longestWork, double(round(pauses.busiest.busy, 4))),
                (ros.longestWorkCode, text(pauses.busiest.code)),
                (ros.recentPause, double(round(pauses.recent, 4))),
                *problem_statements(problems),
            ),
            *triples_about(NamedNode(space.base), (ros.hasServerStatus, status), *graph_state(graph)),
        ),
    )


def _plain(pauses: Pauses, graph: Graph, problems: ServerProblems) -> bytes:
    end, robot = date_time_literal(pauses.longest.ended_ns), graph.state
    since = date_time_literal(robot.since_ns) if isinstance(robot, Stale) else None
    return orjson.dumps(
        {
            "longestPause": round(pauses.longest.seconds, 4),
            "longestPauseEnd": None if end is None else end.value,
            "longestPauseCode": pauses.longest.code,
            "longestWork": round(pauses.busiest.busy, 4),
            "longestWorkCode": pauses.busiest.code,
            "recentPause": round(pauses.recent, 4),
            "storageProblem": [*problems.storage],
            "interruptedHold": [*problems.interrupted_holds],
            "robot": {
                "state": type(robot).__name__,
                "staleSince": None if since is None else since.value,
                "reason": robot.why if isinstance(robot, Stale) else None,
            },
        }
    )
