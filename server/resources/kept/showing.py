"""Records shown: whole, in parts, in pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rosld.ontology.document import Document
from rosld.server.http.link import Link, render
from rosld.server.http.problem import Problem
from rosld.server.ldp.interaction import (
    declared,
    membership_triples,
    model_links,
)
from rosld.server.ldp.parts import ALL, Parts
from rosld.server.ldp.resource import (
    LDP,
)
from rosld.server.ldp.state import State
from rosld.server.records import Member, Record
from rosld.server.records.describe import record_document
from rosld.server.robot import Robot

PAGE = 1000
"""Members of a container that are told at once; a larger one comes in pages."""


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


def page_shown(robot: Robot, record: Record, parts: Parts, after: int) -> State:
    """One page of a container: the members made after number `after` (LDP Paging 1.0)."""
    url = robot.space.base + record.path
    found = robot.records.members(record.path, after=after, most=PAGE)
    links = [Link(f"{LDP}Page", "type"), Link(f"{url}?page=0", "first"), Link(url, "canonical")]
    if len(found) == PAGE:
        links.append(Link(f"{url}?page={found[-1].number}", "next"))
    headers = {"link": render([*model_links(record.model), *links])}
    return robot.states.get(
        f"{url}?page={after}#{parts.variant}",
        (record.version, record.listed),
        lambda: _state(robot, record, parts, found, headers=headers, page=f"p{after}"),
    )


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
) -> State:
    url = robot.space.base + record.path
    tag = f"{record.version}-{record.listed}{page}{parts.variant}" if record.model.is_container else f"{record.version}"
    if parts.applied:
        headers = {**headers, "preference-applied": str(parts.preference_applied)}
    if record.model.is_container:
        headers = {**headers, "vary": "Accept, Prefer"}
    return State(
        lambda: _document(robot, record, parts, url, members),
        token=tag,
        scope=robot.records.identity,
        headers=headers,
    )


def _document(robot: Robot, record: Record, parts: Parts, url: str, members: Sequence[Member]) -> Document:
    membership = declared(record.membership, url) if record.membership is not None and parts.minimal else []
    if record.membership is not None and parts.membership:
        membership += membership_triples(
            record.membership, [each.member or robot.space.base + each.path for each in members]
        )
    contained = [robot.space.base + each.path for each in members] if parts.containment else []
    kept = record if parts.minimal else replace(record, triples=b"")
    return record_document(kept, url, contained, membership)


def after_page(text: str) -> int:
    """The number that `?page=` names; a 404 Problem for what is none."""
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise Problem(404, f"?page={text[:100]} is no page of this container; follow the links from ?page=0.")
    return int(text)
