"""Tables over HTTP, as Parquet, Arrow or CSV: sent in pieces, as they are made in a thread."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

from msgspec.structs import replace
from starlette.responses import Response, StreamingResponse

from rosld.adapters.base import MessageFilter, Recording
from rosld.adapters.model import RosError
from rosld.server.history.tables import (
    NoPyarrow,
    NoTable,
    Rows,
    TableParts,
    TopicTable,
    pieces,
    require_pyarrow,
)
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.problem import Problem
from rosld.server.resources.bags import BagBase
from rosld.server.resources.base import Services
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import CSV, FORMATS, OFFERS, TABLES
from rosld.server.rest.path_item import FORMAT
from rosld.server.rest.resource import RESOURCE
from rosld.server.rest.responses import RawResponse
from rosld.server.rest.state import State
from rosld.server.sparql.process.pool import Aborted

TABLE_FORMAT = replace(FORMAT, schema={"type": "string", "enum": [*FORMATS, *TABLES]})
"""The parameter `format` of a resource that is also a table."""
TABLE_READS = (*OFFERS, *TABLES.values())
_AT_ONCE = 1024 * 1024
"""Bytes up to which a table is sent whole, with its length."""
_EXECUTOR = ThreadPoolExecutor(2, "tables")
"""Tables are made two at a time: each part needs memory."""


def wanted_table(exchange: Exchange) -> str | None:
    """Return the name of the format of tables that a request for a resource prefers, or None."""
    chosen = exchange.preferred(TABLES, TABLE_READS)
    return next((name for name, media_type in TABLES.items() if media_type == chosen), None)


async def table_response(
    format: str, make: Callable[[], TableParts], name: str, headers: Mapping[str, str],
    footer: Callable[[], Mapping[str, str]] = dict, *, is_head: bool = False,
) -> Response:  # fmt: skip
    """Return the response with a table, which `make` returns in a thread as its schema and its parts.

    `name` is that of the file without its ending, `footer` is metadata that is known at the end. Raises Problems: 406
    without pyarrow, and for what has no table.
    """
    media_type = TABLES[format] if format != "csv" else f"{CSV}; charset=utf-8"
    fields = {"content-type": media_type, "vary": "Accept", "cache-control": "no-cache", **headers}
    fields["content-disposition"] = f'inline; filename="{name}.{format}"'
    if is_head:
        return RawResponse(200, b"", _encoded(fields))
    loop = asyncio.get_running_loop()

    def made() -> Iterator[bytes]:
        require_pyarrow()
        yield from pieces(format, make(), footer)

    source = made()

    def following() -> bytes | None:
        return next(source, None)

    first: list[bytes] = []
    try:
        while sum(map(len, first)) <= _AT_ONCE:
            if (piece := await loop.run_in_executor(_EXECUTOR, following)) is None:
                fields["content-length"] = str(sum(map(len, first)))
                return RawResponse(200, b"".join(first), _encoded(fields))
            first.append(piece)
    except (NoPyarrow, NoTable) as error:
        words = str(error)
        raise Problem(406, f"{words[0].upper()}{words[1:]}.") from error

    async def stream() -> AsyncIterator[bytes]:
        for each in first:
            yield each
        try:
            while (piece := await loop.run_in_executor(_EXECUTOR, following)) is not None:
                yield piece
        except (RosError, OSError, ValueError, MemoryError) as error:
            raise Aborted(f"a table could not be completed: {error}") from error

    return StreamingResponse(stream(), headers=fields)


def _encoded(fields: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode(), value.encode("latin-1")) for name, value in fields.items()]


class BagTable(BagBase):
    """The messages of one topic of a recording as a table."""

    kind = "Table of messages"
    links = (RESOURCE,)

    def __init__(
        self, services: Services, recording: Recording, wanted: MessageFilter, most: int, query: str, format: str
    ) -> None:
        super().__init__(services, f"{services.space.bag_messages(recording.name)}?{query}")
        self.recording = recording
        self.wanted = wanted
        self.most = most
        self.format = format

    async def state(self) -> State:
        raise Problem(406, f"A table is available as {', '.join(TABLES.values())}.")

    async def custom_get(self, exchange: Exchange) -> Response | None:
        topic = self._topic(exchange)
        recording, space, permissions, wanted = self.recording, self.space, exchange.permissions, self.wanted
        rows = Rows(wanted.start, wanted.end, wanted.from_ns, wanted.to_ns, self.most)
        version = recording.identity, recording.first, recording.count, topic, rows, permissions.rights_key
        etag = ETag(digest(repr(version).encode()), self.format)
        if exchange.check_preconditions(etag):
            return Response(status_code=304, headers={"etag": str(etag), "vary": "Accept"})
        tables: list[TopicTable] = []

        def make() -> TableParts:
            may_read, shown = None, None
            if not permissions.may_read_all:
                may_read = lambda index: permissions.may_read(space.bag_message(recording.name, index))  # noqa: E731
                shown = lambda node: permissions.may_read(space.node(node))  # noqa: E731
            table = TopicTable(recording, topic, may_read, shown)
            tables.append(table)
            return table.schema, table.parts(rows)

        name = f"{recording.name}{topic}".replace("/", "-").encode("ascii", "replace").decode().replace('"', "_")
        return await table_response(
            self.format,
            make,
            name,
            {"etag": str(etag)},
            lambda: tables[0].footer(),
            is_head=exchange.method == "HEAD",
        )

    def _topic(self, exchange: Exchange) -> str:
        """Return the only topic. Raises Problems: 400 for none or several, 404 for one that may not be read."""
        topics = self.wanted.topics
        if topics is None:
            raise Problem(400, "A table is of one topic: name it, such as ?topic=/odom&format=parquet.")
        readable = sorted(each for each in topics if exchange.permissions.may_read_topic(each))
        if not readable:
            raise Problem(404, f"{self.recording.name} has no such topic.")
        if len(readable) > 1:
            few = ", ".join(readable[:10])
            raise Problem(400, f"A table is of one topic, and ?topic= matches {few}: name one of them.")
        return readable[0]
