"""`/status`: how promptly the server itself answers, and what is wrong with its storage."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import orjson
from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, double, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.hypermedia.data_schema import DataSchema
from rosld.server.hypermedia.json_schema import TEXT, nullable
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.runtime.watchdog import Pauses, Watchdog

ROUTE = "status"


class StatusResource(Resource):
    """The pauses of the event loop, and the problems of storage."""

    kind = "Server status"

    def __init__(self, space: Space, storage_problems: Callable[[], tuple[str, ...]], watchdog: Watchdog) -> None:
        super().__init__(space.base + ROUTE)
        self._space = space
        self._storage_problems = storage_problems
        self._watchdog = watchdog

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        seconds: DataSchema = {"type": "number", "minimum": 0}
        told: DataSchema = dict.fromkeys(("longestPause", "longestWork", "recentPause"), seconds)
        told = {**told, **dict.fromkeys(("longestPauseEnd", "longestPauseCode", "longestWorkCode"), nullable(TEXT))}
        summary = "How promptly the server itself answers, what is wrong with its storage"
        return PathItem(summary, plain={"type": "object", "properties": told})

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._space.document_shape("ServerStatus"),)

    async def state(self) -> State:
        pauses, problems = self._watchdog.pauses, self._storage_problems()
        return State(lambda: status_document(self.url, pauses, problems), lambda: _plain(pauses, problems))


def status_document(url: str, pauses: Pauses, storage_problems: Sequence[str] = ()) -> Document:
    """The RDF of a server's status; times are in seconds."""
    longest = pauses.longest
    return Document(
        url,
        tuple(
            triples_about(
                NamedNode(url),
                (rdf.type, ros.ServerStatus),
                *RDF_SOURCE,
                (ros.longestPause, double(round(longest.seconds, 4))),
                (ros.longestPauseEnd, date_time_literal(longest.ended_ns)),
                (ros.longestPauseCode, text(longest.code)),
                (ros.longestWork, double(round(pauses.busiest.busy, 4))),
                (ros.longestWorkCode, text(pauses.busiest.code)),
                (ros.recentPause, double(round(pauses.recent, 4))),
                *((ros.storageProblem, text(problem)) for problem in storage_problems),
            )
        ),
    )


def _plain(pauses: Pauses, storage_problems: Sequence[str]) -> bytes:
    end = date_time_literal(pauses.longest.ended_ns)
    return orjson.dumps(
        {
            "longestPause": round(pauses.longest.seconds, 4),
            "longestPauseEnd": None if end is None else end.value,
            "longestPauseCode": pauses.longest.code,
            "longestWork": round(pauses.busiest.busy, 4),
            "longestWorkCode": pauses.busiest.code,
            "recentPause": round(pauses.recent, 4),
            "storageProblem": [*storage_problems],
        }
    )
