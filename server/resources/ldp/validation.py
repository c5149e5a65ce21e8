"""Validators of documents that have an effect: mappings, stored queries and limits are stored once they are valid.

A judge is asked before a write is done, and told what to do with it afterwards; its writes take turns.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from rosld.server.http.problem import Problem
from rosld.server.policies.active_limits import ROUTE as SHAPES
from rosld.server.policies.stored_mappings import ROUTE as MAPPINGS
from rosld.server.policies.stored_mappings import stored_mapping
from rosld.server.policies.stored_queries import ROUTE as QUERIES
from rosld.server.resources.context import Robot
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.sparql.protocol import QUERY_MEDIA_TYPE
from rosld.server.storage import Model, Put, Remove, Write
from rosld.server.storage.packing import size_of, unpack
from rosld.shapes.message import SHACL_SHACL

MAX_BYTES = 4 * 1024 * 1024
"""Bytes of N-Triples that a mapping, or limits, may say: some 40,000 triples."""


class Validator(Protocol):
    """Says which documents may be stored below a route."""

    shape: str
    """The name, below `/shapes/`, of what constrains it."""
    media_types: Sequence[str]
    """The media types of what may be made."""

    @property
    def conforms_to(self) -> Sequence[str]:
        """The URLs of the shapes of what its documents say, beside that of all that is kept."""
        ...

    @property
    def lock(self) -> asyncio.Lock:
        """Held while a write is judged and done."""
        ...

    async def validate(self, write: Write) -> Callable[[], None]:
        """What is to happen once a write is done. Raises Problems and LoweringError for what must not be done."""
        ...


class MappingValidator:
    """Validates mapping documents, which are in force once they are stored."""

    shape = "mapping"
    media_types: Sequence[str] = RDF_BODIES

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._robot.space.shape(self.shape),)

    @property
    def lock(self) -> asyncio.Lock:
        return self._robot.mappings.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        robot, url = self._robot, self._robot.space.base + write.path
        if isinstance(write, Remove):
            return self._told(lambda: robot.mappings.remove(url))
        if write.model is not Model.RDF_SOURCE or "/" in write.path.removeprefix(MAPPINGS):
            room = robot.space.base + MAPPINGS
            raise Problem(
                409, f"A mapping is an RDF source directly under {room}: files and containers have no place there."
            )
        document = await asyncio.to_thread(stored_mapping, _unpack(write), url)  # a large one takes its time
        robot.mappings.check(document)
        return self._told(lambda: robot.mappings.replace(document))

    def _told(self, act: Callable[[], None]) -> Callable[[], None]:
        def sequel() -> None:
            act()
            self._robot.changes.emit()

        return sequel


class QueryValidator:
    """Validates stored queries, which are stored byte for byte and parsed when they are run."""

    shape = "query"
    media_types: Sequence[str] = (QUERY_MEDIA_TYPE,)

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._robot.space.document_shape("Query"),)

    @property
    def lock(self) -> asyncio.Lock:
        return self._robot.queries.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        if isinstance(write, Put):
            await self._permissions(write)
        return self._robot.changes.emit

    async def _permissions(self, put: Put) -> None:
        robot = self._robot
        if put.blob is None or "/" in put.path.removeprefix(QUERIES):
            room = robot.space.base + QUERIES
            raise Problem(
                409, f"A stored query is {QUERY_MEDIA_TYPE} directly under {room}: nothing else has a place there."
            )
        before = robot.records.get(put.path)
        if before is not None and before.blob == put.blob:
            return  # its description changes
        try:
            await asyncio.to_thread(robot.queries.check, put.path, put.blob)  # a long one takes its time
        except ValueError as error:
            robot.records.discard(put.blob)
            raise Problem(422, f"This is no stored query: {error}.") from error


class LimitsValidator:
    """Validates limits, which bound what may be written once they are stored."""

    shape = "limits"
    media_types: Sequence[str] = RDF_BODIES

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def conforms_to(self) -> Sequence[str]:
        return (SHACL_SHACL,)

    @property
    def lock(self) -> asyncio.Lock:
        return self._robot.active_limits.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        limits, url = self._robot.active_limits, self._robot.space.base + write.path
        if isinstance(write, Remove):
            return self._told(lambda: limits.remove(url))
        if write.model is not Model.RDF_SOURCE or "/" in write.path.removeprefix(SHAPES):
            room = self._robot.space.base + SHAPES
            raise Problem(409, f"Limits are an RDF source directly under {room}: nothing else has a place there.")
        try:
            graph = await asyncio.to_thread(limits.check, url, _unpack(write))  # a large one takes its time
        except ValueError as error:
            words = f"These limits cannot be put in force: {error}. Relative IRIs are relative to {url}."
            raise Problem(422, words) from error
        return self._told(lambda: limits.replace(url, graph))

    def _told(self, act: Callable[[], None]) -> Callable[[], None]:
        def sequel() -> None:
            act()
            self._robot.states.clear()  # bounds are part of what resources say of themselves
            self._robot.changes.emit()

        return sequel


def _unpack(put: Put) -> bytes:
    """The N-Triples that a document says. Raises a 413 Problem for more than is read beside the loop in good time."""
    if size_of(put.triples) > MAX_BYTES:
        words = f"A document that is put in force has at most {MAX_BYTES} bytes of N-Triples"
        raise Problem(413, f"{words}, and this one {size_of(put.triples)}: split it into several.")
    return unpack(put.triples)


_JUDGES: Mapping[str, Callable[[Robot], Validator]] = {
    MAPPINGS: MappingValidator,
    QUERIES: QueryValidator,
    SHAPES: LimitsValidator,
}


def validator_of(robot: Robot, path: str) -> Validator | None:
    """Who judges what is kept at a path; nobody, for most."""
    room = path[: path.find("/") + 1]
    return _JUDGES[room](robot) if room in _JUDGES and path != room else None
