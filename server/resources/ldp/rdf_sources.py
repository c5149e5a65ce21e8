"""RDF sources, files, and the descriptions of files (LDP 4.3, 4.4)."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence, Set
from contextlib import suppress
from functools import partial
from pathlib import Path

from pyoxigraph import Triple
from starlette.responses import Response

from rosld.ontology.body import parse_json
from rosld.server.dataset.base import TripleChanges
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.http.body import MULTIPART, codec_for, to_utf8
from rosld.server.http.conditional import ETag
from rosld.server.http.fields import Link
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.patches.patch import TooManyTriples, merge_patch
from rosld.server.resources.ldp.base import ANYTHING, Documents, StoredResource, with_warnings
from rosld.server.resources.ldp.bodies import (
    as_statements,
    client_statements,
    managed_triples_in,
    merged_statements,
    read_statements,
    receive_blob,
    require_membership,
    require_model,
    require_same_containment,
    require_unchanged,
    single_chunk,
)
from rosld.server.resources.ldp.representation import state_of
from rosld.server.resources.ldp.statements import (
    MAX_PATCHED,
    N3_PATCH,
    SMALL_BYTES,
    KeptChange,
    Statements,
    change_statements,
    has_blank_nodes,
    has_managed,
    member_uri,
    merge_statements,
    parse_patch,
    patch_record,
    patch_statements,
    require_same_members,
)
from rosld.server.resources.ldp.versions import former_of, has_versions
from rosld.server.resources.memento import VARY, present, timegate_links
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.interaction import model_links
from rosld.server.rest.resource import Answer, Resource, StorageWrite
from rosld.server.rest.responses import file_response, no_content, resource_headers
from rosld.server.rest.state import State, require_memory
from rosld.server.runtime.offload import Work
from rosld.server.storage.record import MAX_BYTES as DIFFERENT
from rosld.server.storage.record import (
    NO_MEMBER,
    Blob,
    Conflict,
    ConflictCause,
    Difference,
    Model,
    Put,
    Record,
    Remove,
    Write,
    container_of,
)
from rosld.server.storage.record_documents import META, client_times, is_large, to_ntriples, unpack_triples

__all__ = ["N3_PATCH", "DescriptionResource", "RdfSourceResource"]


class RdfSourceResource(StoredResource):
    """An RDF source."""

    kind = "RDF source"
    shape = "Source"
    writes = frozenset({"PUT", "POST", "PATCH", "DELETE"})
    in_turn = frozenset({"POST", "PATCH"})
    accepts: Mapping[str, Sequence[str]] = {
        "PUT": RDF_BODIES,
        "POST": (*RDF_BODIES, MULTIPART),
        "PATCH": (SPARQL_UPDATE, N3_PATCH),
    }

    async def prepare(self) -> None:
        """Add links to the TimeGate and the TimeMap if versions are stored."""
        if has_versions(self.documents.settings, self.path):
            self.links = (*type(self).links, *timegate_links(self.url))

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the former version (`?at=TIME`) or the TimeMap (`?timemap`) that the request selects."""
        former = former_of(self.documents, self.path, exchange)
        if former is None and has_versions(self.documents.settings, self.path):
            return await present(await super().select_variant(exchange), exchange)
        return former or await super().select_variant(exchange)

    @property
    def conforms_to(self) -> Sequence[str]:
        validator = self.documents.validator_of(self.path)
        return (*super().conforms_to, *(() if validator is None else validator.conforms_to))

    async def state(self) -> State:
        state = state_of(self.documents, self.require_record())
        if has_versions(self.documents.settings, self.path):
            state.headers = {**state.headers, "vary": VARY}
        return state

    async def forms(self) -> Sequence[Form]:
        return [DeleteForm("Delete it")] if "DELETE" in self.methods() else []

    async def put(self, exchange: Exchange) -> Answer:
        """Replace all triples (LDP 4.2.4). Unconditional writes: last one wins."""
        self.require_if_match(exchange)
        require_model(exchange, self.require_record().model)
        triples = await read_statements(self.documents.workers, exchange, self.document_url, self._subject)

        async def replaced(record: Record) -> Write:
            whole = record.model is Model.RDF_SOURCE and not exchange.is_conditional
            expected = None if whole else record.version  # None: last one wins
            return await self.with_triples(record, triples, expected)

        await self.change_record(exchange, replaced)
        return await with_warnings(self.documents, self.path, exchange, no_content())

    async def post(self, exchange: Exchange) -> Answer:
        """Merge the body into the triples (SPARQL 1.1 Graph Store Protocol 5.5)."""
        read = merged_statements if exchange.essence == MULTIPART else read_statements
        added = await read(self.documents.workers, exchange, self.document_url, self._subject)

        async def with_added(record: Record) -> Write:
            before = state_of(self.documents, record)
            require_memory(before)
            if before.is_large and not has_managed(added.managed, self._subject):
                change = partial(change_statements, record.triples, b"", unpack_triples(added.packed))
                if (put := await self._changed(record, change)) is not None:
                    return put
            work = partial(merge_statements, before.describe, added, self._subject)
            is_large = added.is_large or before.is_large
            stated = await self.documents.workers.run(work) if is_large else work()
            return await self.with_triples(record, stated, record.version)

        await self.change_record(exchange, with_added)
        return await with_warnings(self.documents, self.path, exchange, no_content())

    async def patch(self, exchange: Exchange) -> Answer:
        """Apply a SPARQL Update or an N3 Patch to the current triples; retry if another request changes them."""
        data, media_type, url = await exchange.body(), exchange.media_type, self.document_url

        def patch(before: Sequence[Triple]) -> Sequence[Triple]:
            return parse_patch(data, media_type, url, MAX_PATCHED)(before)

        async def changed(record: Record) -> Write:
            before = state_of(self.documents, record)
            require_memory(before)
            if not before.is_large:
                with suppress(TooManyTriples):
                    triples = before.document.triples
                    after = await self._patch(patch, triples)
                    return await self.with_triples(record, after, record.version, frozenset(triples))
            change = partial(patch_record, record, before.describe, data, media_type, url, self._subject)
            if before.is_large and (put := await self._changed(record, change)) is not None:
                return put
            work = partial(patch_statements, before.describe, data, media_type, url, self._subject)
            return await self.with_triples(record, await self.documents.workers.run(work), record.version)

        await self.change_record(exchange, changed)
        return await with_warnings(self.documents, self.path, exchange, no_content())

    async def _changed(self, record: Record, change: Work[KeptChange | None], *, is_long: bool = True) -> Put | None:
        """Return the write of a change of the stored triples, computed in a worker if it `is_long`.

        None if the change is not enough and the whole document must be checked.
        """
        if record.membership is not None or record.member == NO_MEMBER:
            return None
        found = await self.documents.workers.run(change) if is_long else change()
        if found is None:
            return None
        content, *lines = found
        difference = None
        if sum(map(len, lines)) <= DIFFERENT and not any(map(has_blank_nodes, lines)):
            difference = Difference(record, b"".join(client_times(record, self._subject)), *lines)
        return Put(
            record.path,
            record.model,
            content,
            record.blob,
            record.membership,
            expected=record.version,
            difference=difference,
        )

    async def _patch(
        self, patch: Callable[[Sequence[Triple]], Sequence[Triple]], before: Sequence[Triple]
    ) -> Sequence[Triple]:
        after = await asyncio.to_thread(patch, before)  # a malicious patch may take long
        require_same_members(before, after, self.url)
        return after

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> StorageWrite:
        method = "DELETE" if triples is None else "PUT"
        if method not in self.methods():
            raise self.not_allowed(method, 403)
        if triples is None:
            return StorageWrite(f"delete {self.title}", (Remove(self.path, self.require_record().version),))
        record = self.require_record()
        return StorageWrite(f"store {self.title}", (await self.with_triples(record, triples, record.version),))

    async def plan_graph_change(self, change: TripleChanges) -> StorageWrite | None:
        if "PUT" not in self.methods():
            raise self.not_allowed("PUT", 403)
        record = self.require_record()
        if has_managed((*change.removed, *change.added), self._subject):
            return None
        removed, added = map(to_ntriples, change)
        is_long = is_large(record) or len(removed) + len(added) > SMALL_BYTES
        put = await self._changed(record, partial(change_statements, record.triples, removed, added), is_long=is_long)
        if put is None:
            return None
        is_changed = put.difference is None or put.difference.removed or put.difference.added
        return StorageWrite(f"store {self.title}", (put,) if is_changed else ())

    @property
    def document_url(self) -> str:
        """The base of relative IRIs."""
        return self.url

    @property
    def _subject(self) -> str:
        """The subject of server-managed triples."""
        return self.space.base + self.path

    async def with_triples(
        self, record: Record, triples: Sequence[Triple], expected: int | None, known: Set[Triple] = frozenset()
    ) -> Put:
        """Return the write that replaces the triples of a record; server-managed triples must be unchanged or absent.

        The write expects the version `expected`, or any version (None). `known` are triples known to be unchanged.
        Raises 409 Problems for changed server-managed triples, and like `as_statements`.
        """
        url = self._subject
        stated = await as_statements(triples, url)
        managed = managed_triples_in(stated.managed, url, record.model)
        times = b"".join(client_times(record, url))
        if record.membership is not None or managed or times:
            new = [each for each in managed if each not in known] if known else managed
            if new:
                require_same_containment(self.documents, record, managed)
                require_unchanged(new, record, url)
                if record.membership is not None:
                    require_membership(record.membership, new, url)
            content = await client_statements(self.documents, record, stated, times)
        else:
            content = stated.packed
        member = await self._member(record, stated)
        difference = stated.difference(record, url, times) if expected == record.version else None
        return Put(
            record.path, record.model, content, record.blob, record.membership, member, expected, difference=difference
        )

    async def _member(self, record: Record, stated: Statements) -> str | None:
        """Return the new member URI in the membership triples of the container; None keeps the present one."""
        if record.member != NO_MEMBER:
            return None
        container = self.documents.records.get(container_of(record.path))
        if container is None or container.membership is None:
            return None
        work = partial(member_uri, container.membership, stated, self._subject)
        return await self.documents.workers.run(work) if stated.is_large else work()


class DescriptionResource(RdfSourceResource):
    """The description of a file, at the file's URL plus `.meta`, with the file's lifetime (LDP 4.2.1.6, 5.2.3.12)."""

    kind = "Description"
    shape = "File"
    writes = frozenset({"PUT", "POST", "PATCH"})
    in_turn = frozenset({"PUT", "POST", "PATCH"})

    def __init__(self, documents: Documents, path: str) -> None:
        super().__init__(documents, path.removesuffix(META))
        self.url = documents.space.base + path
        self.title = "/" + path

    async def forms(self) -> Sequence[Form]:
        return ()


class StoredFile(StoredResource):
    """A non-RDF source: bytes stored as sent."""

    kind = "File"
    writes = frozenset({"PUT", "PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": (ANYTHING,), "PATCH": (MERGE_PATCH,)}

    def __init__(self, documents: Documents, path: str) -> None:
        super().__init__(documents, path)
        self.links = (*model_links(Model.NON_RDF_SOURCE), Link(self.url + META, "describedby"))

    def streams_body(self, exchange: Exchange) -> bool:
        return exchange.method == "PUT"

    async def state(self) -> State:
        return state_of(self.documents, self.require_record())

    in_turn = frozenset({"PATCH"})

    async def custom_get(self, exchange: Exchange) -> Response | None:
        while True:
            record = self.require_record()
            try:
                return await self._file_response(exchange, record)
            except FileNotFoundError:
                if self.documents.records.get(self.path) is record:  # no other request has replaced it meanwhile
                    raise

    async def _file_response(self, exchange: Exchange, record: Record) -> Response:
        """Return the response with the file's bytes. Raises FileNotFoundError if it was removed."""
        assert record.blob is not None
        etag = ETag(f"{self.documents.records.identity}-{record.version}", "bin")
        headers = {**resource_headers(self), "vary": "Accept", "cache-control": "no-cache"}
        if exchange.check_preconditions(etag):
            return Response(status_code=304, headers={**headers, "etag": str(etag)})
        return await file_response(
            self.documents.records.file(record.blob),
            record.blob.size,
            record.blob.media_type,
            str(etag),
            headers=headers,
            name=self.title.rpartition("/")[2],
            range_=exchange.header("range"),
            if_range=exchange.header("if-range"),
            head=exchange.method == "HEAD",
        )

    async def put(self, exchange: Exchange) -> Answer:
        """Replace the bytes and their media type (RFC 9110 9.3.4). Raises a 507 Problem if the disk is full."""
        self.require_if_match(exchange)
        before = self.require_record()
        require_model(exchange, before.model)
        return await self.replace(exchange, before, await receive_blob(self.documents, exchange))

    async def replace(self, exchange: Exchange, before: Record, blob: Blob) -> Answer:
        """Return the answer to a PUT of these bytes; `before` is the record that the request was checked against."""

        async def with_these(record: Record) -> Write:
            return with_blob(before if exchange.is_conditional else record, blob)

        await self.change_record(exchange, with_these)
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        """Apply a JSON merge patch to a JSON file (RFC 7396)."""
        patch = await exchange.body()
        if len(patch) <= SMALL_BYTES:
            parse_json(patch)  # before all else that may be wrong

        async def changed(record: Record) -> Write:
            return with_blob(record, await self._patch(record, patch))

        await self.change_record(exchange, changed)
        return Response(status_code=204)

    async def _patch(self, record: Record, patch: bytes) -> Blob:
        assert record.blob is not None
        if record.blob.media_type.partition(";")[0].strip() != JSON:
            raise Problem(415, f"{MERGE_PATCH} applies to {JSON}, but this is {record.blob.media_type}.")
        if record.blob.size > self.documents.settings.body_limit:
            raise Problem(413, f"A file of {record.blob.size} bytes is too large to patch; PUT all of it.")
        is_light = record.blob.size + len(patch) <= SMALL_BYTES
        try:
            work = partial(merge_json_file, self.documents.records.file(record.blob), patch, record.blob.media_type)
            data = await (asyncio.to_thread(work) if is_light else self.documents.workers.run(work))
        except FileNotFoundError as error:
            if self.documents.records.get(self.path) is record:
                raise
            raise Conflict(record.path, "its content was replaced meanwhile", ConflictCause.CHANGED) from error
        return await self.documents.records.receive(single_chunk(data), record.blob.media_type, limit=len(data))


def merge_json_file(path: Path, patch: bytes, media_type: str) -> bytes:
    """Return the JSON of a file after a merge patch (RFC 7396). Raises FileNotFoundError, LoweringError."""
    stated = parse_media_type(media_type)
    before = parse_json(to_utf8(path.read_bytes(), stated))
    return json.dumps(merge_patch(before, parse_json(patch))).encode(codec_for(stated))  # integers of any size


def with_blob(record: Record, blob: Blob) -> Put:
    """Return the record of a file with other bytes."""
    return Put(record.path, record.model, record.triples, blob, expected=record.version)
