"""Records shown: whole, in parts, in pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pyoxigraph import Triple

from rosld.ontology.document import Document
from rosld.server.http.link import render
from rosld.server.ldp.interaction import (
    declared,
    membership_triples,
    model_links,
)
from rosld.server.ldp.paging import Page, Place, page_of
from rosld.server.ldp.parts import ALL, Parts
from rosld.server.ldp.state import State
from rosld.server.records import Member, Record
from rosld.server.records.describe import record_document
from rosld.server.robot import Robot


def all_members(robot: Robot, record: Record) -> list[Member]:
    """All members of a container."""
    found: list[Member] = []
    if record.model.is_container:
        while page := robot.records.members(record.path, after=found[-1].number if found else 0):
            found += page
    return found


def shown(robot: Robot, record: Record, parts: Parts = ALL) -> State:
    """A record as it is, or the parts of a container that are asked for: kept while it does not change."""
    url = robot.space.base + record.path
    return robot.states.get(
        f"{url}#{parts.variant}",
        (record.version, record.listed),
        lambda: _state(robot, record, parts, all_members(robot, record) if _lists(parts) else []),
    )


def page_shown(robot: Robot, record: Record, parts: Parts, place: Place) -> State:
    """One page of a container (LDP Paging 1.0)."""
    url = robot.space.base + record.path

    def make() -> State:
        page, found = page_at(robot, record, place)
        headers = {"link": render([*model_links(record.model), *page.links()])}
        return _state(robot, record, parts, found, headers=headers, page=f"p{place.token}", said=page.triples())

    return robot.states.get(f"{url}?page={place.token}#{parts.variant}", (record.version, record.listed), make)


def page_at(robot: Robot, record: Record, place: Place) -> tuple[Page, Sequence[Member]]:
    """The page of a container at a place, and its members."""
    found = robot.records.members(record.path, after=place.after, most=place.most + 1)
    page = page_of(robot.space.base + record.path, place, [each.number for each in found])
    return page, found[: place.most]


def _lists(parts: Parts) -> bool:
    return parts.containment or parts.membership


def _state(
    robot: Robot,
    record: Record,
    parts: Parts,
    members: Sequence[Member],
    *,
    headers: Mapping[str, str] = {},
    page: str = "",
    said: Sequence[Triple] = (),
) -> State:
    url = robot.space.base + record.path
    tag = f"{record.version}-{record.listed}" if record.model.is_container else f"{record.version}"
    if parts.applied:
        headers = {**headers, "preference-applied": str(parts.preference_applied)}
    if record.model.is_container:
        headers = {**headers, "vary": "Accept, Prefer"}
    return State(
        lambda: _document(robot, record, parts, url, members, said),
        token=tag,
        scope=robot.records.identity,
        part=f"{page}{parts.variant}",
        headers=headers,
    )


def _document(
    robot: Robot, record: Record, parts: Parts, url: str, members: Sequence[Member], more: Sequence[Triple]
) -> Document:
    membership = declared(record.membership, url) if record.membership is not None and parts.minimal else []
    if record.membership is not None and parts.membership:
        membership += membership_triples(
            record.membership, [each.member or robot.space.base + each.path for each in members]
        )
    contained = [robot.space.base + each.path for each in members] if parts.containment else []
    kept = record if parts.minimal else replace(record, triples=b"")
    return record_document(kept, url, contained, [*membership, *more])
