"""`/status`: how promptly the server itself answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import orjson
from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, about, double, moment, text
from rosld.ontology.urls import Location
from rosld.ontology.vocab import rdf, ros
from rosld.server.http.problem import Problem
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot
from rosld.server.watchdog import Pauses, Watchdog

ROOM = "status"


class StatusResource(Resource):
    """The pauses of the event loop."""

    kind = "Server status"

    def __init__(self, robot: Robot, watchdog: Watchdog) -> None:
        super().__init__(robot.space.base + ROOM)
        self._watchdog = watchdog

    async def state(self) -> State:
        pauses = self._watchdog.pauses
        return State(lambda: status_document(self.url, pauses), lambda: _plain(pauses))


def status_room(watchdog: Watchdog) -> Mapping[str, Callable[[Robot, Location], Resource]]:
    """The room of the server's status."""

    def room(robot: Robot, location: Location) -> Resource:
        if location.segments or location.is_container:
            raise Problem(404, f"There is nothing below /{ROOM}.")
        return StatusResource(robot, watchdog)

    return {ROOM: room}


def status_document(url: str, pauses: Pauses) -> Document:
    """The RDF of a server's status; times are in seconds."""
    longest = pauses.longest
    return Document(
        url,
        tuple(
            about(
                NamedNode(url),
                (rdf.type, ros.ServerStatus),
                *RDF_SOURCE,
                (ros.longestPause, double(round(longest.seconds, 4))),
                (ros.longestPauseEnd, moment(longest.ended_ns)),
                (ros.longestPauseCode, text(longest.code)),
                (ros.recentPause, double(round(pauses.recent, 4))),
            )
        ),
    )


def _plain(pauses: Pauses) -> bytes:
    end = moment(pauses.longest.ended_ns)
    return orjson.dumps(
        {
            "longestPause": round(pauses.longest.seconds, 4),
            "longestPauseBusy": round(pauses.longest.busy, 4),
            "longestPauseEnd": None if end is None else end.value,
            "longestPauseCode": pauses.longest.code,
            "recentPause": round(pauses.recent, 4),
        }
    )
