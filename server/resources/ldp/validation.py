"""Validators of documents that have an effect: mappings, stored queries, limits and cockpits are stored once valid.

A validator is called before a write is done; what it returns is called afterwards. Its writes are serialised by `lock`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Protocol

from rosld.ontology.urls import Space
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.policies.active_limits import ROUTE as SHAPES
from rosld.server.policies.active_limits import ActiveLimits
from rosld.server.policies.stored_cockpits import ROUTE as COCKPITS
from rosld.server.policies.stored_cockpits import check_cockpit
from rosld.server.policies.stored_mappings import ROUTE as MAPPINGS
from rosld.server.policies.stored_mappings import stored_mapping
from rosld.server.policies.stored_queries import ROUTE as QUERIES
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.rest.state import State
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.sparql.protocol import QUERY_MEDIA_TYPE
from rosld.server.storage.record import Model, Put, Remove, Write
from rosld.server.storage.record_documents import unpack_triples, unpacked_size
from rosld.server.storage.sqlite import Records
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
        """Held while a write is validated and done."""
        ...

    async def validate(self, write: Write) -> Callable[[], None]:
        """Return what to call once a write is done. Raises Problems and LoweringError for one that must not be done."""
        ...


class MappingValidator:
    """Validates mapping documents, which are in force once they are stored."""

    shape = "mapping"
    media_types: Sequence[str] = RDF_BODIES

    def __init__(self, mappings: Mappings, space: Space, announce: Callable[[], None]) -> None:
        """`announce` tells that other mappings are in force."""
        self._mappings = mappings
        self._space = space
        self._announce = announce

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._space.shape(self.shape),)

    @property
    def lock(self) -> asyncio.Lock:
        return self._mappings.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        url = self._space.base + write.path
        if isinstance(write, Remove):
            return self._announce_after(lambda: self._mappings.remove(url))
        if write.model is not Model.RDF_SOURCE or "/" in write.path.removeprefix(MAPPINGS):
            container = self._space.base + MAPPINGS
            raise Problem(
                409, f"A mapping is an RDF source directly under {container}: files and containers have no place there."
            )
        document = await asyncio.to_thread(stored_mapping, _unpack(write), url)  # a large one takes its time
        self._mappings.check(document)
        return self._announce_after(lambda: self._mappings.replace(document))

    def _announce_after(self, act: Callable[[], None]) -> Callable[[], None]:
        def sequel() -> None:
            act()
            self._announce()

        return sequel


class QueryValidator:
    """Validates stored queries, which are stored byte for byte and parsed when they are run."""

    shape = "query"
    media_types: Sequence[str] = (QUERY_MEDIA_TYPE,)

    def __init__(self, queries: StoredQueries, records: Records, space: Space, announce: Callable[[], None]) -> None:
        """`announce` tells that other queries are kept."""
        self._queries = queries
        self._records = records
        self._space = space
        self._announce = announce

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._space.document_shape("Query"),)

    @property
    def lock(self) -> asyncio.Lock:
        return self._queries.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        if isinstance(write, Put):
            await self._permissions(write)
        return self._announce

    async def _permissions(self, put: Put) -> None:
        if put.blob is None or "/" in put.path.removeprefix(QUERIES):
            container = self._space.base + QUERIES
            raise Problem(
                409, f"A stored query is {QUERY_MEDIA_TYPE} directly under {container}: nothing else has a place there."
            )
        before = self._records.get(put.path)
        if before is not None and before.blob == put.blob:
            return  # its description changes
        try:
            await asyncio.to_thread(self._queries.check, put.path, put.blob)  # a long one takes its time
        except ValueError as error:
            self._records.discard(put.blob)
            raise Problem(422, f"This is no stored query: {error}.") from error


class LimitsValidator:
    """Validates limits, which bound what may be written once they are stored."""

    shape = "limits"
    media_types: Sequence[str] = RDF_BODIES

    def __init__(
        self, limits: ActiveLimits, states: VersionCache[State], space: Space, announce: Callable[[], None]
    ) -> None:
        """`announce` tells that other limits are in force."""
        self._limits = limits
        self._states = states
        self._space = space
        self._announce = announce

    @property
    def conforms_to(self) -> Sequence[str]:
        return (SHACL_SHACL,)

    @property
    def lock(self) -> asyncio.Lock:
        return self._limits.lock

    async def validate(self, write: Write) -> Callable[[], None]:
        limits, url = self._limits, self._space.base + write.path
        if isinstance(write, Remove):
            return self._announce_after(lambda: limits.remove(url))
        if write.model is not Model.RDF_SOURCE or "/" in write.path.removeprefix(SHAPES):
            container = self._space.base + SHAPES
            raise Problem(409, f"Limits are an RDF source directly under {container}: nothing else has a place there.")
        try:
            graph = await asyncio.to_thread(limits.check, url, _unpack(write))  # a large one takes its time
        except ValueError as error:
            words = f"These limits cannot be put in force: {error}. Relative IRIs are relative to {url}."
            raise Problem(422, words) from error
        return self._announce_after(lambda: limits.replace(url, graph))

    def _announce_after(self, act: Callable[[], None]) -> Callable[[], None]:
        def sequel() -> None:
            act()
            self._states.clear()  # bounds are part of what resources say of themselves
            self._announce()

        return sequel


class CockpitValidator:
    """Validates cockpits, which are pages once they are stored."""

    shape = "cockpit"
    media_types: Sequence[str] = RDF_BODIES

    def __init__(self, space: Space) -> None:
        self._space = space
        self._lock = asyncio.Lock()

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._space.shape(self.shape),)

    @property
    def lock(self) -> asyncio.Lock:
        return self._lock

    async def validate(self, write: Write) -> Callable[[], None]:
        if isinstance(write, Put):
            await self._check(write)
        return _nothing

    async def _check(self, put: Put) -> None:
        container = self._space.base + COCKPITS
        if put.model is not Model.RDF_SOURCE or "/" in put.path.removeprefix(COCKPITS):
            raise Problem(
                409, f"A cockpit is an RDF source directly under {container}: files and containers have no place there."
            )
        await asyncio.to_thread(check_cockpit, _unpack(put), self._space.base + put.path)


def _nothing() -> None:
    """Nothing is to be done."""


def _unpack(put: Put) -> bytes:
    """The N-Triples that a document says. Raises a 413 Problem for more than is read beside the loop in good time."""
    if unpacked_size(put.triples) > MAX_BYTES:
        words = f"A document that is put in force has at most {MAX_BYTES} bytes of N-Triples"
        raise Problem(413, f"{words}, and this one {unpacked_size(put.triples)}: split it into several.")
    return unpack_triples(put.triples)
