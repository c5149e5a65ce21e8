"""Files: non-RDF sources, bytes as they were sent (LDP 4.4)."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from starlette.responses import Response

from rosld.ontology.body import parse_json
from rosld.server.http.body import codec_for, to_utf8
from rosld.server.http.conditional import ETag, check_preconditions
from rosld.server.http.fields import Link
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.patches.patch import merge_patch
from rosld.server.resources.ldp.base import ANYTHING, Documents, StoredResource
from rosld.server.resources.ldp.bodies import receive_blob, require_model, single_chunk
from rosld.server.resources.ldp.representation import state_of
from rosld.server.resources.ldp.statements import SMALL_BYTES
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH
from rosld.server.rest.interaction import model_links
from rosld.server.rest.resource import Answer
from rosld.server.rest.responses import file_response, resource_headers
from rosld.server.rest.state import State
from rosld.server.storage.record import Blob, Conflict, ConflictCause, Model, Put, Record, Write
from rosld.server.storage.record_documents import META


class StoredFile(StoredResource):
    """A non-RDF source: bytes as they were sent."""

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
                if self.documents.records.get(self.path) is record:  # nobody has replaced it meanwhile
                    raise

    async def _file_response(self, exchange: Exchange, record: Record) -> Response:
        """Return the response with the file's bytes. Raises FileNotFoundError if it was removed."""
        assert record.blob is not None
        etag = ETag(f"{self.documents.records.identity}-{record.version}", "bin")
        if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
        headers = {**resource_headers(self), "vary": "Accept", "cache-control": "no-cache"}
        if check_preconditions(exchange.method, etag, if_match=if_match, if_none_match=if_none_match):
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
        """Replace the bytes and their media type (RFC 9110 9.3.4). Raises a 507 Problem where there is no space."""
        self.require_if_match(exchange)
        before = self.require_record()
        require_model(exchange, before.model, self.url)
        return await self.replace(exchange, before, await receive_blob(self.documents, exchange))

    async def replace(self, exchange: Exchange, before: Record, blob: Blob) -> Answer:
        """Return the answer to a PUT of these bytes; `before` is what the request was judged against."""

        async def with_these(record: Record) -> Write:
            return with_blob(before if exchange.is_conditional else record, blob)

        await self.change_record(exchange, with_these)
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        """JSON merge patch of a JSON file (RFC 7396)."""
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
            raise Problem(415, f"{MERGE_PATCH} changes {JSON}, and this is {record.blob.media_type}.")
        if record.blob.size > self.documents.settings.body_limit:
            raise Problem(413, f"A file of {record.blob.size} bytes is too large to be patched; PUT it whole.")
        is_light = record.blob.size + len(patch) <= SMALL_BYTES
        try:
            work = partial(merge_json_file, self.documents.records.file(record.blob), patch, record.blob.media_type)
            data = await (asyncio.to_thread(work) if is_light else self.documents.workers.run(work))
        except FileNotFoundError as error:
            if self.documents.records.get(self.path) is record:
                raise
            raise Conflict(record.path, "its bytes were replaced meanwhile", ConflictCause.CHANGED) from error
        return await self.documents.records.receive(single_chunk(data), record.blob.media_type, limit=len(data))


def merge_json_file(path: Path, patch: bytes, media_type: str) -> bytes:
    """The JSON of a file of a media type after a merge patch (RFC 7396). Raises FileNotFoundError, LoweringError."""
    stated = parse_media_type(media_type)
    before = parse_json(to_utf8(path.read_bytes(), stated))
    return json.dumps(merge_patch(before, parse_json(patch))).encode(codec_for(stated))  # integers of any size


def with_blob(record: Record, blob: Blob) -> Put:
    """Return the record of a file with other bytes."""
    return Put(record.path, record.model, record.triples, blob, expected=record.version)
