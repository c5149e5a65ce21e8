"""Representations of records and their documents. Pure; few imports, because worker processes import this module."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from msgspec.structs import replace
from pyoxigraph import Triple

from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.http.fields import render_links
from rosld.server.resources.ldp.base import Documents
from rosld.server.rest.interaction import member_derived_uris, membership_declaration, membership_triples, model_links
from rosld.server.rest.paging import (
    ALL_PARTS,
    MAX_PAGE_SIZE,
    ContainerParts,
    LdpPage,
    PagePosition,
    last_page_size,
    last_position,
    page_of,
)
from rosld.server.rest.state import State
from rosld.server.storage.record import Member, Record
from rosld.server.storage.record_documents import record_document, unpacked_size, without_statements
from rosld.server.storage.sqlite import Records


def stored_document(
    base: str, record: Record, parts: ContainerParts, members: Sequence[Member], more: Sequence[Triple]
) -> Document:
    """Return the requested parts of a record, with these members of a container, and the triples `more`."""
    url = base + record.path
    membership = (
        membership_declaration(record.membership, url) if record.membership is not None and parts.minimal else []
    )
    if record.membership is not None and parts.membership:
        membership += membership_triples(record.membership, member_derived_uris_of(base, members))
    contained = [base + each.path for each in members] if parts.containment else []
    stripped = record if parts.minimal else without_statements(record, url)
    return record_document(stripped, url, contained, [*membership, *more])


def member_derived_uris_of(base: str, members: Iterable[Member]) -> list[str]:
    """Return the URIs of members in the membership triples of their container (LDP 5.4.1.5, 5.5.1.2)."""
    return list(member_derived_uris((base + each.path, each.member) for each in members))


def all_members(records: Records, record: Record) -> list[Member]:
    """Return all members of a container."""
    found: list[Member] = []
    if record.model.is_container:
        while page := records.members(record.path, after=found[-1].number if found else 0):
            found += page
    return found


def member_uris(space: Space, members: Iterable[Member]) -> list[str]:
    """Return the URIs of members in the membership triples of their container (LDP 5.4.1.5, 5.5.1.2)."""
    return member_derived_uris_of(space.base, members)


def state_of(documents: Documents, record: Record, parts: ContainerParts = ALL_PARTS) -> State:
    """Return the current state of a record, or the requested parts of a container. Cached until it changes.

    The state of a paged container omits its members, so that its cost does not grow with their number.
    """
    if record.count > MAX_PAGE_SIZE:
        parts = replace(parts, containment=False, membership=False)
    url = documents.space.base + record.path
    return documents.states.get_or_make(
        f"{url}#{parts.variant}",
        (record.version, record.listed),
        lambda: _state(documents, record, parts, all_members(documents.records, record) if _lists(parts) else []),
    )


def former_state(documents: Documents, record: Record) -> State:
    """Return the state of a document in a former version of its record."""
    return _state(documents, record, ALL_PARTS, [])


def page_state(documents: Documents, record: Record, parts: ContainerParts, place: PagePosition) -> State:
    """Return the state of one page of a container (LDP Paging 1.0)."""
    url = documents.space.base + record.path

    def make() -> State:
        page, found = page_at(documents, record, place)
        links = page.links(f"{documents.records.identity}-{_tag(record)}.any")
        headers = {"link": render_links([*model_links(record.model), *links])}
        return _state(documents, record, parts, found, headers=headers, page=f"p{place.token}", more=page.triples())

    return documents.states.get_or_make(
        f"{url}?page={place.token}#{parts.variant}", (record.version, record.listed), make
    )


def page_at(documents: Documents, record: Record, place: PagePosition) -> tuple[LdpPage, Sequence[Member]]:
    """Return the page of a container at a place, and its members."""
    records, after, limit = documents.records, place.after, place.limit
    assert isinstance(after, int)
    found = records.members(record.path, after=after, limit=limit + 1)
    before = records.last_member_numbers(record.path, up_to=after, limit=limit + 1) if after else ()
    latest = (
        records.last_member_numbers(record.path, limit=last_page_size(record.count, limit) + 1)
        if len(found) > limit
        else ()
    )
    last = last_position(limit, record.count, latest)
    page = page_of(documents.space.base + record.path, place, [each.number for each in found], before, last)
    return page, found[:limit]


def _lists(parts: ContainerParts) -> bool:
    return parts.containment or parts.membership


def _tag(record: Record) -> str:
    return f"{record.version}-{record.listed}" if record.model.is_container else f"{record.version}"


def _state(
    documents: Documents,
    record: Record,
    parts: ContainerParts,
    members: Sequence[Member],
    *,
    headers: Mapping[str, str] = {},
    page: str = "",
    more: Sequence[Triple] = (),
) -> State:
    if parts.applied:
        headers = {**headers, "preference-applied": str(parts.preference_applied)}
    if record.model.is_container:
        headers = {**headers, "vary": "Accept, Prefer"}
    return State(
        partial(stored_document, documents.space.base, record, parts, members, more),
        token=_tag(record),
        scope=documents.records.identity,
        part=f"{page}{parts.variant}",
        headers=headers,
        weight=unpacked_size(record.triples) if parts.minimal else 0,
    )
