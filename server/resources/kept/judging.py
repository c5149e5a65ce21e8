"""Judges: rooms whose documents mean something are kept like any others, once they are found good.

A judge is asked before a write is done, and told what to do with it afterwards; its writes take turns.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from pyoxigraph import RdfFormat, parse

from rosld.ontology.body import indexed
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.documents import MappingDocument, mapping_of
from rosld.server.records import Model, Put, Remove, Write
from rosld.server.robot import Robot

MAPPINGS = "mappings/"


class Judge(Protocol):
    """Says what may be kept in a room."""

    shape: str
    """The name, below `/shapes/`, of what constrains it."""

    @property
    def turn(self) -> asyncio.Lock:
        """Held while a write is judged and done."""
        ...

    async def judged(self, write: Write) -> Callable[[], None]:
        """What is to happen once a write is done. Raises Problems and LoweringError for what must not be done."""
        ...


class MappingJudge:
    """Keeps mapping documents: what is kept is in force."""

    shape = "mapping"

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def turn(self) -> asyncio.Lock:
        return self._robot.mapping_turn

    async def judged(self, write: Write) -> Callable[[], None]:
        robot, url = self._robot, self._robot.space.base + write.path
        if isinstance(write, Remove):
            return self._told(lambda: robot.mappings.remove(url))
        if write.model is not Model.RDF_SOURCE or "/" in write.path.removeprefix(MAPPINGS):
            room = robot.space.base + MAPPINGS
            raise Problem(
                409, f"A mapping is an RDF source directly under {room}: files and containers have no place there."
            )
        document = await asyncio.to_thread(mapping_kept, write, url)  # a large one takes its time
        robot.mappings.check(document)
        return self._told(lambda: robot.mappings.replace(document))

    def _told(self, act: Callable[[], None]) -> Callable[[], None]:
        def sequel() -> None:
            act()
            self._robot.changes.give()

        return sequel


def mapping_kept(put: Put, url: str) -> MappingDocument:
    """The mapping that is kept as these triples. Raises MappingRefused."""
    return mapping_of(indexed(parse(put.triples, RdfFormat.N_TRIPLES), url), url)


def judge_of(robot: Robot, path: str) -> Judge | None:
    """Who judges what is kept at a path; nobody, for most."""
    return MappingJudge(robot) if path.startswith(MAPPINGS) and path != MAPPINGS else None
