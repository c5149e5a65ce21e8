"""Former versions of stored documents and cockpits: `?at=TIME`, `?timemap`, Accept-Datetime (RFC 7089)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from msgspec.structs import replace

from rosld.server.http.problem import Problem
from rosld.server.policies.stored_cockpits import ROUTE as COCKPITS
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.ldp.representation import former_state
from rosld.server.resources.memento import (
    VARY,
    Memento,
    TimeMap,
    found,
    memento_datetime,
    memento_url,
    parse_accept_datetime,
    read_time,
    timegate_links,
    wanted_datetime,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.settings import Settings
from rosld.server.storage.record import Model, Record
from rosld.server.storage.sqlite import Records

_ROOTS = ("data/", COCKPITS)


def has_versions(settings: Settings, path: str) -> bool:
    """Whether former versions of a document at this path are stored."""
    return settings.versions > 0 and path.startswith(_ROOTS) and not path.endswith("/")


def memento_times(records: Records, path: str) -> list[int]:
    """Return the times in ns when the stored versions of a document were written, ascending."""
    current = records.get(path)
    times = [each.modified_ns for each in records.versions(path)]
    is_document = current is not None and current.model is Model.RDF_SOURCE
    return [*times, current.modified_ns] if current is not None and is_document else times


def version_at(records: Records, path: str, time_ns: int) -> Record | None:
    """Return the version of a document at a time, which may be the current one, or None if there was none."""
    current = records.get(path)
    if current is not None and current.model is Model.RDF_SOURCE and current.modified_ns <= time_ns:
        return current
    return records.version_at(path, time_ns)


def former_of(documents: Documents, path: str, exchange: Exchange) -> Resource | None:
    """Return the requested former version of a document, or None. Raises Problems: 302, 400, 404."""
    if exchange.method not in ("GET", "HEAD"):
        return None
    query, wanted = exchange.query, wanted_datetime(exchange)
    parameter = next((name for name in ("timemap", "timegate", "at") if name in query), None)
    if not has_versions(documents.settings, path):
        if parameter is not None and path.startswith(_ROOTS) and documents.settings.versions == 0:
            raise Problem(404, f"?{parameter}: no former versions are kept; start with rosld serve --versions N.")
        return None
    if parameter is None and wanted is None:
        return None
    times = memento_times(documents.records, path)
    if not times:
        return None
    space, url = documents.space, documents.space.base + path
    if "timemap" in query:
        return TimeMap(space, url, f"/{path}", partial(_all_mementos, documents.records, path))
    if "at" in query:
        at_ns = read_time(query["at"], time.time_ns())
        record = version_at(documents.records, path, at_ns)
        if record is None:
            raise Problem(404, f"There was no /{path} at {query['at'][:60]}, or that version is no longer kept.")
        now = Resource(space, url)
        now.title, now.links = f"/{path}", (RESOURCE, RDF_SOURCE)
        return Memento(now, "Document as it was", query["at"], partial(_state_at, documents, record, at_ns))
    assert wanted is not None
    at_ns = parse_accept_datetime(wanted)
    chosen = max((each for each in times if each <= at_ns), default=times[0])
    raise found(memento_url(url, chosen), timegate_links(url))


async def _all_mementos(records: Records, path: str) -> tuple[Sequence[int], None]:
    return memento_times(records, path), None


async def _state_at(documents: Documents, record: Record, at_ns: int) -> State:
    state = former_state(documents, record)
    headers = {**state.headers, "vary": VARY}
    if at_ns < time.time_ns():  # a version at a future time may still change
        headers["memento-datetime"] = memento_datetime(record.modified_ns)
    return replace(state, headers=headers, renderings={}, redactions={})
