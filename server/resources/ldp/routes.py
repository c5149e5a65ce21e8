"""Routes of `/data/` and below: the resource at a path according to the current records."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from functools import partial

from pyoxigraph import Triple

from rosld.ontology.document import Document
from rosld.ontology.urls import Location
from rosld.server.http.body import MULTIPART
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, MessageSchemas
from rosld.server.patches.patch import has_deletes
from rosld.server.resources.ldp.base import (
    DELETES,
    Documents,
    StoredResource,
    conflict_problem,
    missing_problem,
    with_warnings,
    write_together,
)
from rosld.server.resources.ldp.bodies import merge_parts, model_of_request, receive_blob, require_model
from rosld.server.resources.ldp.containers import create_resource, creation_writes, require_free, resource_of
from rosld.server.resources.ldp.rdf_sources import DescriptionResource, StoredFile
from rosld.server.resources.ldp.representation import state_of
from rosld.server.resources.ldp.statements import N3_PATCH, is_small, patch_statements
from rosld.server.resources.ldp.versions import former_of
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import MERGE_PATCH, OFFERS, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.path_item import ANY_TYPE, PathItem, WriteMethod
from rosld.server.rest.resource import ABSENT, READ, Answer, CreatedAnswer, Resource, StorageWrite, permanent_redirect
from rosld.server.rest.responses import resource_headers
from rosld.server.rest.state import State
from rosld.server.storage.record import Blob, Conflict, ConflictCause, Model
from rosld.server.storage.record_documents import META
from rosld.server.storage.sqlite import Records

_PATCHES = (SPARQL_UPDATE, N3_PATCH)


class AbsentResource(StoredResource):
    """A missing resource: PUT creates it, and so does a PATCH that only inserts (Solid Protocol 5.3.1)."""

    kind = "Absent"
    in_turn = frozenset({"PATCH"})
    links = ()
    merges = False
    """Whether the body is merged into a resource created meanwhile, instead of replacing it."""

    def __init__(self, documents: Documents, path: str) -> None:
        super().__init__(documents, path)
        puts = RDF_BODIES if path.endswith("/") else self.accepted_media_types
        self.accepts: Mapping[str, Sequence[str]] = {"PUT": puts}
        if RDF_BODIES[0] in puts:
            self.accepts = {"PUT": puts, "PATCH": _PATCHES}
            if not path.endswith("/"):  # POST to a container would create a member
                self.accepts |= {"POST": (*RDF_BODIES, MULTIPART)}

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        """Return the path item of any stored resource; the actual one depends on its kind."""
        methods = READ if self.documents.settings.read_only else READ | {"PUT", "POST", "PATCH", "DELETE"}
        is_limits = self.path.startswith("shapes/")
        if is_limits:
            return PathItem(
                "Limits of a client",
                writes={"PUT": WriteMethod(accepts=RDF_BODIES), "PATCH": WriteMethod(accepts=_PATCHES)},
                methods=methods,
            )
        accepted = (*RDF_BODIES, ANY_TYPE)
        return PathItem(
            "A document of a client: RDF, a file, or a container if the path ends in a slash",
            (*OFFERS, ANY_TYPE),
            ANYTHING,
            writes={
                "PUT": WriteMethod(accepts=accepted),
                "POST": WriteMethod(accepts=accepted),
                "PATCH": WriteMethod(accepts=(*_PATCHES, MERGE_PATCH)),
                "DELETE": DELETES,
            },
            is_paged=True,
            methods=methods,
        )

    def methods(self) -> frozenset[str]:
        return ABSENT if self.documents.settings.read_only else ABSENT | self.accepts.keys()

    async def select_variant(self, exchange: Exchange) -> Resource:
        former = former_of(self.documents, self.path, exchange)
        if former is not None:
            return former
        method = exchange.method
        may_make = method in ("PUT", "OPTIONS") or exchange.essence in self.accepts.get(method, ())
        if not may_make:
            raise self._missing(exchange)
        if method == "POST":
            await self.merge_into(exchange)
        return self

    async def merge_into(self, exchange: Exchange) -> None:
        """Let a POST create an RDF source, or merge into one created meanwhile (Graph Store Protocol 5.5).

        Raises like `merge_parts`.
        """
        if exchange.essence == MULTIPART:
            await merge_parts(self.documents.workers, exchange, self.url)
        self.merges = True
        exchange.method = "PUT"

    def _missing(self, exchange: Exchange) -> Problem:
        """Return the Problem of a missing resource, with the models that may be created there."""
        problem = missing_problem(self.documents, self.path)
        if problem.status in (404, 410) and self.methods() > ABSENT and exchange.permissions.may("PUT", self.url):
            problem.headers |= {name: value for name, value in resource_headers(self).items() if name != "link"}
        return problem

    async def state(self) -> State:
        found = self.documents.records.get(self.path)
        if found is None:
            raise missing_problem(self.documents, self.path)
        return state_of(self.documents, found)  # it was made while this request waited for its turn

    def streams_body(self, exchange: Exchange) -> bool:
        return exchange.method == "PUT" and self._model(exchange) is Model.NON_RDF_SOURCE

    def _model(self, exchange: Exchange) -> Model:
        return model_of_request(exchange, self.url, container=self.url.endswith("/"))

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> StorageWrite:
        if "PUT" not in self.methods():
            raise self.not_allowed("PUT", 403)
        if triples is None:
            raise missing_problem(self.documents, self.path)
        return StorageWrite(
            f"make {self.title}", tuple(await creation_writes(self.documents, self.path, self._plain_model, triples))
        )

    @property
    def _plain_model(self) -> Model:
        """Return the model if none is requested."""
        return Model.BASIC_CONTAINER if self.path.endswith("/") else Model.RDF_SOURCE

    async def put(self, exchange: Exchange) -> Answer:
        """Create the resource from the body (LDP 4.2.4), or replace one created meanwhile.

        Raises a 412 Problem if a conditional request finds a resource created meanwhile.
        """
        model, blob = self._model(exchange), None
        if model is Model.NON_RDF_SOURCE:
            require_free(self.documents, self.path)
            blob = await receive_blob(self.documents, exchange)
        try:
            return await create_resource(self.documents, self.path, model, exchange, blob)
        except Conflict as error:
            if error.path != self.path or error.cause is not ConflictCause.THERE:
                raise conflict_problem(self.space, error) from error
        if exchange.is_conditional:
            raise Problem(412, f"{self.url} was created by another request meanwhile; nothing was done.")
        return await self._once_more(exchange, blob)

    async def patch(self, exchange: Exchange) -> Answer:
        """Create the resource from the insertions of a patch, or patch one created meanwhile.

        Raises a 404 or 410 Problem for a patch that deletes something.
        """
        if self.documents.records.get(self.path) is not None:
            return await self._patch_there(exchange)
        data, media_type = await exchange.body(), exchange.media_type
        if media_type == SPARQL_UPDATE and has_deletes(data):
            raise self._missing(exchange)
        work = partial(patch_statements, partial(Document, self.url, ()), data, media_type, self.url, self.url)
        triples = await (asyncio.to_thread(work) if is_small(data) else self.documents.workers.run(work))
        try:
            record = (
                await write_together(
                    self.documents, await creation_writes(self.documents, self.path, self._plain_model, triples)
                )
            )[-1]
        except Conflict as error:
            # A conditional request is not retried: its preconditions were checked against a missing resource.
            if error.path != self.path or error.cause is not ConflictCause.THERE or exchange.is_conditional:
                raise conflict_problem(self.space, error) from error
            return await self._patch_there(exchange)
        assert record is not None
        made = resource_of(self.documents, self.path, record.model)
        created = CreatedAnswer(made.url, made, state_of(self.documents, record))
        return await with_warnings(self.documents, self.path, exchange, created)

    async def _patch_there(self, exchange: Exchange) -> Answer:
        there = resource_of(self.documents, self.path, self.require_record().model)
        if exchange.media_type not in there.accepts["PATCH"]:
            raise Problem(415, f"PATCH takes {', '.join(there.accepts['PATCH'])} here, not {exchange.media_type}.")
        return await there.patch(exchange)

    async def _once_more(self, exchange: Exchange, blob: Blob | None) -> Answer:
        """Retry as an update of the resource created meanwhile (unconditional writes: last one wins)."""
        record = self.require_record()
        there = resource_of(self.documents, self.path, record.model)
        if isinstance(there, StoredFile):
            require_model(exchange, record.model)
            return await there.replace(exchange, record, blob or await receive_blob(self.documents, exchange))
        if blob is not None:
            raise Problem(415, f"PUT takes {', '.join(RDF_BODIES)} here, not {blob.media_type}.")
        return await (there.post(exchange) if self.merges else there.put(exchange))


def missing_description(records: Records, path: str) -> Problem:
    """Return 410 if the description was deleted with its file (LDP 5.2.5.2), else 404."""
    file = path.removesuffix(META)
    if records.is_tombstone(file):
        return Problem(410, f"/{file} was deleted, and its description with it.")
    return Problem(
        404,
        f"/{path} would describe the file /{file}, which does not exist: PUT the file, and its description is created.",
    )


def stored_route(documents: Documents, location: Location) -> Resource:
    """Return the resource at `/data/` or below, or an `AbsentResource` if it has no record.

    Raises a 308 Problem for `/data`, and a 404 or 410 Problem for the description of a missing file.
    """
    if not location.segments and not location.is_container:
        raise permanent_redirect(documents.space.container(location.kind))
    path = documents.space.url(location.kind, location.segments)[len(documents.space.base) :]
    if location.is_container:
        path += "/"
    record = documents.records.get(path)
    if record is not None:
        return resource_of(documents, path, record.model)
    if path.endswith(META):
        described = documents.records.get(path.removesuffix(META))
        if described is None or described.model is not Model.NON_RDF_SOURCE:
            raise missing_description(documents.records, path)
        return DescriptionResource(documents, path)
    return AbsentResource(documents, path)
