"""Base of the resources that clients keep."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Sequence
from typing import ClassVar

from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.urls import Space
from rosld.server.http.conditional import require_if_match
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import BOOLEAN, MessageSchemas
from rosld.server.resources.ldp.documents import Documents
from rosld.server.resources.ldp.transaction import write_together
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.rest.path_item import PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, Resource, permanent_redirect
from rosld.server.runtime.dry_run import expect_status
from rosld.server.storage.record import Conflict, ConflictCause, Record, Remove, Write

ANYTHING = "*/*"

DELETES = WriteMethod(
    done=(204,), query=(QueryParameter("versions", "Whether its former versions are deleted, too.", BOOLEAN),)
)
"""Description of DELETE of a stored document."""

EXTRA_STATUSES = (303, 410, 507)
"""Statuses of refusals that what clients keep has beside the usual ones."""


class StoredResource(Resource):
    """Base of the resources that clients keep. `path` is the URL without the base."""

    is_cacheable = False
    passes_unknown_parameters = frozenset({"GET", "HEAD"})  # browsers add some to bypass caches

    def __init__(self, documents: Documents, path: str) -> None:
        super().__init__(documents.space.base + path)
        self.documents = documents
        self.path = path
        self.title = "/" + path

    writes: ClassVar[frozenset[str]] = frozenset()

    @property
    def accepted_media_types(self) -> Sequence[str]:
        """The media types of what may be made here: those of its validator, where there is one."""
        permissions = self.documents.validator_of(self.path + "?")
        return (*RDF_BODIES, ANYTHING) if permissions is None else permissions.media_types

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(self.kind, writes={"DELETE": DELETES})

    def methods(self) -> frozenset[str]:
        return READ if self.documents.settings.read_only else READ | self.writes

    def deny_reason(self, method: str) -> str:
        if self.documents.settings.read_only:
            return "This server is read-only."
        return f"{self.kind} resources do not answer {method}."

    @property
    def constrained_by(self) -> str | None:
        permissions = self.documents.validator_of(self.path)
        return self.documents.space.shape("data" if permissions is None else permissions.shape)

    def require_record(self) -> Record:
        """The record; a 404 or 410 Problem where there is none."""
        found = self.documents.records.get(self.path)
        if found is None:
            raise missing_problem(self.documents, self.path)
        return found

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        return self.documents.changes.watch(wake, lambda path: path == self.path)

    def require_if_match(self, exchange: Exchange) -> None:
        """Raise a 428 Problem for a PUT without If-Match where the settings demand it (LDP 4.2.4.5)."""
        if self.documents.settings.demand_if_match:
            require_if_match(exchange.header("if-match"), "A document is replaced by clients that have read it.")

    async def change_record(self, exchange: Exchange, make: Callable[[Record], Awaitable[Write]]) -> None:
        """Do what `make` makes of the record as it is.

        Where somebody else changes it meanwhile it is made anew, or 412 if the request is conditional. A 503 Problem
        where others change it all the time.
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
                    raise conflict_problem(self.documents.space, error) from error
                if time.monotonic() > until:
                    words = f"{self.url} was changed by others all the time for {patience:g} s; nothing was done."
                    raise Problem(503, words, headers={"Retry-After": "1"}) from error

    async def delete(self, exchange: Exchange) -> Answer:
        """Remove the record, which leaves a tombstone; with `?versions=true` its former versions, too.

        Raises a 409 Problem for a container that has members, 412 where another has changed it.
        """
        with_versions = exchange.query_flag("versions") and self.documents.settings.versions > 0

        async def removed(record: Record) -> Write:
            return Remove(self.path, record.version if exchange.is_conditional else None, with_versions)

        await self.change_record(exchange, removed)
        return Response(status_code=204)


def conflict_problem(space: Space, error: Conflict) -> Problem:
    """The Problem of a write that cannot be done as things are."""
    status = {ConflictCause.GONE: 410, ConflictCause.CHANGED: 412, ConflictCause.MISSING: 404}.get(error.cause, 409)
    url = space.base + error.path
    return Problem(status, f"{url}: {error.words}.", about=(url,))


def missing_problem(documents: Documents, path: str) -> Problem:
    """410 where something was removed and not made again, 308 to a container, else 404."""
    if documents.records.is_tombstone(path):
        return Problem(410, f"/{path} was deleted; PUT makes it again.")
    other = path[:-1] if path.endswith("/") else path + "/"
    if documents.records.get(other) is not None:
        return permanent_redirect(documents.space.base + other)
    return Problem(404, f"There is nothing at /{path}; PUT makes it.")
