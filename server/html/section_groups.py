"""Folding: a page that describes very many things shows them by kind, folded, to be unfolded or searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rosld.server.html.description import Section

MAX_SECTIONS = 40
"""Sections that a page shows one below the other. More of them are folded, by kind."""


@dataclass(frozen=True, slots=True)
class SectionGroup:
    """The sections of one kind."""

    title: str
    sections: tuple[Section, ...]


def group_sections(sections: Sequence[Section]) -> tuple[SectionGroup, ...]:
    """The sections by kind, in the order in which kinds first come; none where they are few."""
    if len(sections) <= MAX_SECTIONS:
        return ()
    kinds: dict[str, list[Section]] = {}
    for section in sections:
        kinds.setdefault(section.kind or "others", []).append(section)
    return tuple(SectionGroup(kind, tuple(each)) for kind, each in kinds.items())
