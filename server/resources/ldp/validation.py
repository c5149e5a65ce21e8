"""Validators of documents that have an effect: mappings, stored queries, limits and cockpits are stored once valid.

A validator is called before a write is done; what it returns is called afterwards. Its writes are serialised by `lock`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial

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


class Validator:
    """Says which documents may be stored directly below a route, and puts them into force."""

    route: str
    shape: str
    """The name, below `/shapes/`, of what constrains it."""
    media_types: Sequence[str] = RDF_BODIES
    """The media types of what may be made."""
    what: str
    """What its documents are, for the 409 Problem of anything else."""

    def __init__(self, space: Space, lock: asyncio.Lock, announce: Callable[[], None]) -> None:
        """`announce` tells that other documents are in force; `lock` is held while a write is validated and done."""
        self._space = space
        self.lock = lock
        self._announce = announce

    @property
    def conforms_to(self) -> Sequence[str]:
        """The URLs of the shapes of what its documents say, beside that of all that is kept."""
        return (self._space.shape(self.shape),)

    async def validate(self, write: Write) -> Callable[[], None]:
        """Return what to call once a write is done. Raises Problems and LoweringError for one that must not be done."""
        url = self._space.base + write.path
        if isinstance(write, Remove):
            act = self.removal(url)
        else:
            if not self.is_allowed(write) or "/" in write.path.removeprefix(self.route):
                container = self._space.base + self.route
                raise Problem(409, f"{self.what} directly under {container}: nothing else has a place there.")
            act = await self.check(write, url)

        def done() -> None:
            act()
            self._announce()

        return done

    def is_allowed(self, put: Put) -> bool:
        """Whether a document is of the kind that the route takes."""
        return put.model is Model.RDF_SOURCE

    def removal(self, url: str) -> Callable[[], None]:
        """Return what to do once the document at a URL is removed."""
        return _nothing

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        """Return what to do once a document is stored. Raises Problems and LoweringError."""
        raise NotImplementedError


class MappingValidator(Validator):
    """Validates mapping documents, which are in force once they are stored."""

    route = MAPPINGS
    shape = "mapping"
    what = "A mapping is an RDF source"

    def __init__(self, mappings: Mappings, space: Space, announce: Callable[[], None]) -> None:
        super().__init__(space, mappings.lock, announce)
        self._mappings = mappings

    def removal(self, url: str) -> Callable[[], None]:
        return partial(self._mappings.remove, url)

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        document = await asyncio.to_thread(stored_mapping, _unpack(put), url)  # a large one takes its time
        self._mappings.check(document)
        return partial(self._mappings.replace, document)


class QueryValidator(Validator):
    """Validates stored queries, which are stored byte for byte and parsed when they are run."""

    route = QUERIES
    shape = "query"
    media_types: Sequence[str] = (QUERY_MEDIA_TYPE,)
    what = f"A stored query is {QUERY_MEDIA_TYPE}"

    def __init__(self, queries: StoredQueries, records: Records, space: Space, announce: Callable[[], None]) -> None:
        super().__init__(space, queries.lock, announce)
        self._queries = queries
        self._records = records

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self._space.document_shape("Query"),)

    def is_allowed(self, put: Put) -> bool:
        return put.blob is not None

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        before, blob = self._records.get(put.path), put.blob
        if blob is not None and (before is None or before.blob != blob):  # else its description changes
            try:
                await asyncio.to_thread(self._queries.check, put.path, blob)  # a long one takes its time
            except ValueError as error:
                self._records.discard(blob)
                raise Problem(422, f"This is no stored query: {error}.") from error
        return _nothing


class LimitsValidator(Validator):
    """Validates limits, which bound what may be written once they are stored."""

    route = SHAPES
    shape = "limits"
    what = "Limits are an RDF source"

    def __init__(
        self, limits: ActiveLimits, states: VersionCache[State], space: Space, announce: Callable[[], None]
    ) -> None:
        super().__init__(space, limits.lock, announce)
        self._limits = limits
        self._states = states

    @property
    def conforms_to(self) -> Sequence[str]:
        return (SHACL_SHACL,)

    def removal(self, url: str) -> Callable[[], None]:
        return partial(self._change, partial(self._limits.remove, url))

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        try:
            graph = await asyncio.to_thread(self._limits.check, url, _unpack(put))  # a large one takes its time
        except ValueError as error:
            words = f"These limits cannot be put in force: {error}. Relative IRIs are relative to {url}."
            raise Problem(422, words) from error
        return partial(self._change, partial(self._limits.replace, url, graph))

    def _change(self, change: Callable[[], None]) -> None:
        change()
        self._states.clear()  # bounds are part of what resources say of themselves


class CockpitValidator(Validator):
    """Validates cockpits, which are pages once they are stored."""

    route = COCKPITS
    shape = "cockpit"
    what = "A cockpit is an RDF source"

    def __init__(self, space: Space) -> None:
        super().__init__(space, asyncio.Lock(), _nothing)

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        await asyncio.to_thread(check_cockpit, _unpack(put), url)
        return _nothing


def _nothing() -> None:
    """Nothing is to be done."""


def _unpack(put: Put) -> bytes:
    """The N-Triples that a document says. Raises a 413 Problem for more than is read beside the loop in good time."""
    if unpacked_size(put.triples) > MAX_BYTES:
        words = f"A document that is put in force has at most {MAX_BYTES} bytes of N-Triples"
        raise Problem(413, f"{words}, and this one {unpacked_size(put.triples)}: split it into several.")
    return unpack_triples(put.triples)
