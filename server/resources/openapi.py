"""`/openapi.json`: the description, in OpenAPI 3.1, of everything that is here now."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from functools import partial

from starlette.responses import Response

from rosld import __version__
from rosld.server.access import gate
from rosld.server.access.door import OPEN
from rosld.server.access.judge import Judge
from rosld.server.http import negotiation
from rosld.server.http.conditional import ETag
from rosld.server.http.link import Link
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.prepared import held
from rosld.server.ldp.resource import LDP, RESOURCE, Resource
from rosld.server.ldp.standing import standing_headers
from rosld.server.ldp.state import digest
from rosld.server.openapi.description import description
from rosld.server.openapi.places import OPENAPI, Places, Resolve, learn
from rosld.server.openapi.rights import for_agent
from rosld.server.robot import Robot, Same

_ABOUT = (
    "A robot as Linked Data. Every resource links to others, begin at `/`; every answer about a resource says in Allow "
    "what may be done with it, and problems say what to do next (RFC 9457). Everything can be had as RDF in several "
    "syntaxes by Accept; `application/json` is ROS's own JSON where there is a ROS value, in which integers beyond 53 "
    "bits are strings of digits and what is too large, or no UTF-8, is an object that says so."
)


_MOST = 8
"""Sets of rights for which descriptions are kept."""


class OpenApiResource(Resource):
    """The description, made once for each state of the graph, the types at hand and the mappings in force."""

    kind = "Description"
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, robot: Robot, resolve: Resolve) -> None:
        super().__init__(f"{robot.space.base}openapi.json")
        self.robot = robot
        self._resolve = resolve
        self._kept: dict[bool, tuple[Hashable, bytes]] = {}
        self._of_agents: dict[tuple[bool, str, str], tuple[bytes, bytes]] = {}
        self._making = asyncio.Lock()

    async def special(self, exchange: Exchange) -> Response | None:
        media_type = negotiation.choose(exchange.accept, OPENAPI)
        if media_type is None:
            raise Problem(406, f"None of {exchange.accept!r} is offered; there are {', '.join(OPENAPI)}.")
        hidden = exchange.flag("hidden") and self.robot.adapter.capabilities.hidden_names
        data = await self._described(hidden)
        if exchange.visit is not OPEN:
            data = await self._for_agent(data, hidden, exchange.judge, exchange.visit.public)
        etag = ETag(f"{self.robot.boot}-{digest(data)}", media_type.partition("/")[2].replace(".", "-"))
        return held(exchange, data, media_type, etag, standing_headers(self).items())

    async def _for_agent(self, data: bytes, hidden: bool, judge: Judge, public: Judge) -> bytes:
        """The description as it is for an agent, kept for as long as it is the same."""
        key = (hidden, judge.key, public.key)
        known = self._of_agents.get(key)
        if known is None or known[0] is not data:
            if len(self._of_agents) >= _MOST:
                self._of_agents.clear()
            mine, anybodys = (partial(self._may, each) for each in (judge, public))
            made = await asyncio.to_thread(for_agent, data, mine, anybodys, whole=judge.whole)
            known = self._of_agents[key] = (data, made)
        return known[1]

    def _may(self, judge: Judge, method: str, path: str) -> bool:
        """Whether a method may be used at a path below the base, or at some that a template stands for."""
        url = self.robot.space.base.rstrip("/") + path
        place = judge.place(url)
        if judge.whole or "{" in path or place is None:
            return judge.may_somewhere(method, url)
        try:
            return method in gate.allowed(judge, place, self._resolve(path))
        except Problem:
            return False

    async def _described(self, hidden: bool) -> bytes:
        kept = self._kept.get(hidden)
        if kept is not None and kept[0] == self._version():
            return kept[1]
        async with self._making:
            kept = self._kept.get(hidden)
            if kept is None or kept[0] != self._version():
                kept = self._kept[hidden] = await self._made(hidden)
            return kept[1]

    def _version(self) -> Hashable:
        robot = self.robot
        return (Same(robot.graph), robot.schemas.count, Same(robot.mappings.arrangement), robot.queries.version)

    async def _made(self, hidden: bool) -> tuple[Hashable, bytes]:
        """A version and its description: found on the loop, written on a thread, for a large one takes its time."""
        robot = self.robot
        await learn(robot)
        layout = await robot.offers.layout()
        version = self._version()
        found = Places(robot, layout, self._resolve, hidden=hidden)
        places = list(found.all())
        title = f"rosld: {robot.name}"
        data = await asyncio.to_thread(description, title, robot.space.base, __version__, _ABOUT, places, found.schemas)
        return version, data
