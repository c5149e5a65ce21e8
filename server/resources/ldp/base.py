"""Base of LDP resources: stored documents, their validators, and their transaction.

A validator is called before a write and returns a callback for after the write. Its `lock` serializes its writes.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import ClassVar

from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.urls import Space
from rosld.server.http.conditional import require_if_match
from rosld.server.http.fields import to_uri
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.http.problem_details import render
from rosld.server.hypermedia.json_schema import BOOLEAN, MessageSchemas
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.policies.active_limits import ROUTE as SHAPES
from rosld.server.policies.active_limits import ActiveLimits
from rosld.server.policies.stored_cockpits import ROUTE as COCKPITS
from rosld.server.policies.stored_cockpits import check_cockpit
from rosld.server.policies.stored_mappings import ROUTE, stored_mapping
from rosld.server.policies.stored_mappings import ROUTE as MAPPINGS
from rosld.server.policies.stored_queries import ROUTE as QUERIES
from rosld.server.policies.stored_queries import StoredQueries
from rosld.server.receipts.audit import record_step
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.rest.path_item import PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer, Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.runtime.dry_run import expect_status
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings
from rosld.server.sparql.protocol import QUERY_MEDIA_TYPE
from rosld.server.storage.record import Conflict, ConflictCause, Model, Put, Record, Remove, Write
from rosld.server.storage.record_documents import unpack_triples, unpacked_size
from rosld.server.storage.sqlite import Records
from rosld.shapes.message import SHACL_SHACL

MAX_BYTES = 4 * 1024 * 1024
"""Maximum size in bytes of a mapping or limits document as N-Triples: some 40,000 triples."""


class Validator:
    """Validator and activator of the documents directly below a route."""

    route: str
    shape: str
    """The name of the shape below `/shapes/` for its documents."""
    media_types: Sequence[str] = RDF_BODIES
    """The media types of documents that may be created."""
    what: str
    """Beginning of the message of the 409 Problem for any other resource."""

    def __init__(self, space: Space, lock: asyncio.Lock, announce: Callable[[], None]) -> None:
        """`announce` is called after each change; `lock` is held during validation and write."""
        self._space = space
        self.lock = lock
        self._announce = announce

    @property
    def conforms_to(self) -> Sequence[str]:
        """The URLs of the shapes of its documents, in addition to that of all stored documents."""
        return (self._space.shape(self.shape),)

    async def validate(self, write: Write) -> Callable[[], None]:
        """Return a callback for after the write. Raises Problems and LoweringError for an invalid write."""
        url = self._space.base + write.path
        if isinstance(write, Remove):
            act = self.removal(url)
        else:
            if not self.is_allowed(write) or "/" in write.path.removeprefix(self.route):
                container = self._space.base + self.route
                raise Problem(409, f"{self.what} directly under {container}: nothing else is allowed there.")
            act = await self.check(write, url)

        def done() -> None:
            act()
            self._announce()

        return done

    def is_allowed(self, put: Put) -> bool:
        """Whether the route accepts this kind of document."""
        return put.model is Model.RDF_SOURCE

    def removal(self, url: str) -> Callable[[], None]:
        """Return a callback for after the removal of the document at a URL."""
        return _nothing

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        """Return a callback for after storing a document. Raises Problems and LoweringError."""
        raise NotImplementedError


class MappingValidator(Validator):
    """Validator of mapping documents, which take effect when stored."""

    route = MAPPINGS
    shape = "mapping"
    what = "A mapping is an RDF source"

    def __init__(self, mappings: Mappings, space: Space, announce: Callable[[], None]) -> None:
        super().__init__(space, mappings.lock, announce)
        self._mappings = mappings

    def removal(self, url: str) -> Callable[[], None]:
        return partial(self._mappings.remove, url)

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        document = await asyncio.to_thread(stored_mapping, _unpack(put), url)  # large documents take long
        self._mappings.check(document)
        return partial(self._mappings.replace, document)


class QueryValidator(Validator):
    """Validator of stored queries, which are stored byte for byte and parsed when they are run."""

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
        if blob is not None and (before is None or before.blob != blob):  # otherwise only the description changes
            try:
                await asyncio.to_thread(self._queries.check, put.path, blob)  # long queries take long
            except ValueError as error:
                self._records.discard(blob)
                raise Problem(422, f"This is not a stored query: {error}.") from error
        return _nothing


class LimitsValidator(Validator):
    """Validator of limits, which constrain writes as soon as they are stored."""

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
            graph = await asyncio.to_thread(self._limits.check, url, _unpack(put))  # large documents take long
        except ValueError as error:
            words = f"These limits cannot be put in force: {error}. Relative IRIs are relative to {url}."
            raise Problem(422, words) from error
        return partial(self._change, partial(self._limits.replace, url, graph))

    def _change(self, change: Callable[[], None]) -> None:
        change()
        self._states.clear()  # states of resources include their bounds


class CockpitValidator(Validator):
    """Validator of cockpits, which are served as pages once they are stored."""

    route = COCKPITS
    shape = "cockpit"
    what = "A cockpit is an RDF source"

    def __init__(self, space: Space) -> None:
        super().__init__(space, asyncio.Lock(), _nothing)

    async def check(self, put: Put, url: str) -> Callable[[], None]:
        await asyncio.to_thread(check_cockpit, _unpack(put), url)
        return _nothing


def _nothing() -> None:
    """Do nothing."""


def _unpack(put: Put) -> bytes:
    """Return the N-Triples of a document. Raises a 413 Problem beyond `MAX_BYTES`."""
    if unpacked_size(put.triples) > MAX_BYTES:
        words = f"A document that is in force can have at most {MAX_BYTES} bytes of N-Triples"
        raise Problem(413, f"{words}, this one has {unpacked_size(put.triples)}: split it into several.")
    return unpack_triples(put.triples)


class Documents(Struct, frozen=True):
    """The records and the services for reading and writing them."""

    space: Space
    settings: Settings
    records: Records
    queries: StoredQueries
    changes: Signal
    """Emits the path of each record that has changed."""
    states: VersionCache[State]
    workers: WorkerPool
    validators: Mapping[str, Validator]
    """Validators by the route of their documents."""
    mapping_warnings: Callable[[str], Awaitable[Sequence[str]]]
    """Returns a warning for each missing thing that the mapping at a URL names."""

    def validator_of(self, path: str) -> Validator | None:
        """Return the validator of documents at a path; None for most."""
        route = path[: path.find("/") + 1]
        return None if path == route else self.validators.get(route)


async def write_together(documents: Documents, writes: Sequence[Write]) -> Sequence[Record | None]:
    """Validate the writes and carry them out in one transaction. Raises Conflict, Problems and LoweringError."""
    for write in writes:
        record_step(
            f"{'store' if isinstance(write, Put) else 'delete'} /{write.path}", documents.space.base + write.path
        )
    validated = [(write, one) for write in writes if (one := documents.validator_of(write.path)) is not None]
    locks = {validator.shape: validator.lock for _, validator in validated}
    async with contextlib.AsyncExitStack() as stack:
        for shape in sorted(locks):
            await stack.enter_async_context(locks[shape])
        callbacks = [await validator.validate(write) for write, validator in validated]
        records = await documents.records.write(*writes)
        for callback in callbacks:
            callback()
        return records


async def with_warnings(documents: Documents, path: str, exchange: Exchange, answer: Answer) -> Answer:
    """Return the answer to a write, replaced by warnings if a mapping names missing things and no Prefer forbids it.

    The warnings suggest existing names, so they require permission to read everything.
    """
    may_warn = exchange.permissions.may_read_all and not (exchange.prefer.minimal or exchange.prefer.representation)
    if not path.startswith(ROUTE) or not may_warn:
        return answer
    url = documents.space.base + path
    warnings = await documents.mapping_warnings(url)
    if not warnings:
        return answer
    is_new = isinstance(answer, CreatedAnswer)
    problem = Problem(
        201 if is_new else 200,
        f"The mapping is in force, but it names things that do not exist now: {' '.join(warnings)}",
        title="In force, with warnings",
        headers={"Location": to_uri(url)} if is_new else {},
    )
    problem.extra |= {"warnings": list(warnings)}
    return render(problem, exchange.accept).response()


ANYTHING = "*/*"

DELETES = WriteMethod(
    done=(204,), query=(QueryParameter("versions", "Whether to delete its former versions, too.", BOOLEAN),)
)
"""Description of DELETE of a stored document."""


class StoredResource(Resource):
    """Base class of resources that clients store. `path` is the URL without the base."""

    is_cacheable = False
    passes_unknown_parameters = frozenset({"GET", "HEAD"})  # browsers add parameters to bypass caches

    def __init__(self, documents: Documents, path: str) -> None:
        super().__init__(documents.space, documents.space.base + path)
        self.documents = documents
        self.path = path
        self.title = "/" + path

    writes: ClassVar[frozenset[str]] = frozenset()

    @property
    def accepted_media_types(self) -> Sequence[str]:
        """The media types that may be created here: those of the validator, if there is one."""
        validator = self.documents.validator_of(self.path + "?")
        return (*RDF_BODIES, ANYTHING) if validator is None else validator.media_types

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(self.kind, writes={"DELETE": DELETES})

    def methods(self) -> frozenset[str]:
        return READ if self.documents.settings.read_only else READ | self.writes

    def deny_reason(self, method: str) -> str:
        if self.documents.settings.read_only:
            return READ_ONLY
        return super().deny_reason(method)

    @property
    def constrained_by(self) -> str | None:
        validator = self.documents.validator_of(self.path)
        return self.space.shape("data" if validator is None else validator.shape)

    def require_record(self) -> Record:
        """Return the record. Raises a 404 or 410 Problem, or a 308 redirect, if there is none."""
        found = self.documents.records.get(self.path)
        if found is None:
            raise missing_problem(self.documents, self.path)
        return found

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        return self.documents.changes.watch(wake, lambda path: path == self.path)

    def require_if_match(self, exchange: Exchange) -> None:
        """Raise a 428 Problem for a PUT without If-Match if the settings demand one (LDP 4.2.4.5)."""
        if self.documents.settings.demand_if_match:
            require_if_match(exchange.header("if-match"), "Read the document before replacing it.")

    async def change_record(self, exchange: Exchange, make: Callable[[Record], Awaitable[Write]]) -> None:
        """Write what `make` returns for the current record.

        Retries if another request changes the record meanwhile; raises a 412 Problem if this request is conditional,
        and a 503 Problem after `call_deadline` seconds of retries.
        """
        patience = self.documents.settings.call_deadline
        until = time.monotonic() + patience
        while True:
            try:
                expect_status(204)
                await write_together(self.documents, [await make(self.require_record())])
                return
            except Conflict as error:
                if error.cause is not ConflictCause.CHANGED or exchange.is_conditional:
                    raise conflict_problem(self.space, error) from error
                if time.monotonic() > until:
                    words = f"{self.url} was changed by others continuously for {patience:g} s; nothing was done."
                    raise Problem(503, words, headers={"Retry-After": "1"}) from error

    async def delete(self, exchange: Exchange) -> Answer:
        """Remove the record, leaving a tombstone; with `?versions=true`, remove its former versions, too.

        Raises a 409 Problem for a container with members, and 412 if a precondition no longer holds.
        """
        with_versions = exchange.query_flag("versions") and self.documents.settings.versions > 0

        async def removed(record: Record) -> Write:
            return Remove(self.path, record.version if exchange.is_conditional else None, with_versions)

        await self.change_record(exchange, removed)
        return Response(status_code=204)


def conflict_problem(space: Space, error: Conflict) -> Problem:
    """Return the Problem of a write that conflicts with the stored state."""
    status = {ConflictCause.GONE: 410, ConflictCause.CHANGED: 412, ConflictCause.MISSING: 404}.get(error.cause, 409)
    url = space.base + error.path
    return Problem(status, f"{url}: {error.words}.", about=(url,))


def missing_problem(documents: Documents, path: str) -> Problem:
    """Return 410 for a deleted resource, 308 if the path exists with (or without) a final slash, else 404."""
    if documents.records.is_tombstone(path):
        return Problem(410, f"/{path} was deleted; PUT to create it again.")
    other = path[:-1] if path.endswith("/") else path + "/"
    if documents.records.get(other) is not None:
        return permanent_redirect(documents.space.base + other)
    return Problem(404, f"There is nothing at /{path}; PUT to create it.")
