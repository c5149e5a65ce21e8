"""`/openapi.json`: the description, in OpenAPI 3.1, of everything that is here now."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable, Mapping

from starlette.responses import Response

from rosld import __version__
from rosld.server.http import negotiation
from rosld.server.http.conditional import ETag, guard
from rosld.server.http.link import Link
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.prepared import Prepared
from rosld.server.ldp.resource import LDP, RESOURCE, Resource
from rosld.server.ldp.state import digest
from rosld.server.openapi.description import description
from rosld.server.openapi.places import OPENAPI, Places, Resolve, learn
from rosld.server.robot import Robot, Same
from rosld.server.sparql.stored import StoredQuery

_ABOUT = (
    "A robot as Linked Data. Every resource links to others, begin at `/`; every answer about a resource says in Allow "
    "what may be done with it, and problems say what to do next (RFC 9457). Everything can be had as RDF in several "
    "syntaxes by Accept; `application/json` is ROS's own JSON where there is a ROS value, in which integers beyond 53 "
    "bits are strings of digits and what is too large, or no UTF-8, is an object that says so."
)


class OpenApiResource(Resource):
    """The description, made once for each state of the graph, the types at hand and the mappings in force."""

    kind = "Description"
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, robot: Robot, queries: Mapping[str, StoredQuery], resolve: Resolve) -> None:
        super().__init__(f"{robot.space.base}openapi.json")
        self.robot = robot
        self._queries = queries
        self._resolve = resolve
        self._kept: tuple[Hashable, bytes] | None = None
        self._making = asyncio.Lock()

    async def special(self, exchange: Exchange) -> Response | None:
        media_type = negotiation.choose(exchange.accept, OPENAPI)
        if media_type is None:
            raise Problem(406, f"None of {exchange.accept!r} is offered; there are {', '.join(OPENAPI)}.")
        data = await self._described()
        etag = ETag(f"{self.robot.boot}-{digest(data)}", media_type.partition("/")[2].replace(".", "-"))
        headers = [
            (b"content-type", media_type.encode()),
            (b"content-length", b"%d" % len(data)),
            (b"etag", str(etag).encode()),
            (b"vary", b"Accept"),
            (b"cache-control", b"no-cache"),
        ]
        if guard("GET", etag, if_match=exchange.header("if-match"), if_none_match=exchange.header("if-none-match")):
            return Prepared(304, b"", headers[2:])
        return Prepared(200, data, headers)

    async def _described(self) -> bytes:
        kept = self._kept
        if kept is not None and kept[0] == self._version():
            return kept[1]
        async with self._making:
            kept = self._kept
            if kept is None or kept[0] != self._version():
                kept = self._kept = await self._made()
            return kept[1]

    def _version(self) -> Hashable:
        robot = self.robot
        return (Same(robot.graph), robot.schemas.count, Same(robot.mappings.arrangement))

    async def _made(self) -> tuple[Hashable, bytes]:
        """A version and its description: found on the loop, written on a thread, for a large one takes its time."""
        robot = self.robot
        await learn(robot)
        layout = await robot.offers.layout()
        version = self._version()
        found = Places(robot, layout, self._queries, self._resolve)
        places = list(found.all())
        title = f"rosld: {robot.name}"
        data = await asyncio.to_thread(description, title, robot.space.base, __version__, _ABOUT, places, found.schemas)
        return version, data
