"""Draws the main classes of the ontology: `python docs/ontology_picture.py` writes `docs/images/ontology.svg`.

Classes, properties, domains, ranges and inverses are those of the files; where each class stands is told here. A
property between neighbours is a line, any other one is in the box of its domain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from pyoxigraph import NamedNode

from rosld.ontology.modules import OWN, module_triples
from rosld.ontology.vocab import owl, rdf, rdfs, ros, schema_org

PICTURE = Path(__file__).parent / "images" / "ontology.svg"
WIDTH, ROW, COLUMN, ROW_STEP, LINE = 196, 82, 356, 132, 14
MARGIN = 16


class Box(NamedTuple):
    """Where a class stands: its column and row, how many rows it spans, and the colour of its module."""

    column: float
    row: float
    rows: int = 1
    colour: str = "#e3f0fb"

    @property
    def x(self) -> float:
        return MARGIN + self.column * COLUMN

    @property
    def y(self) -> float:
        return MARGIN + self.row * ROW_STEP

    @property
    def height(self) -> float:
        return ROW + (self.rows - 1) * ROW_STEP


INTERACTION, TYPES, RECORDING = "#fdeedc", "#e7f5e4", "#f1e8f8"
BOXES: Mapping[str, Box] = {
    "Graph": Box(0, 0),
    "Node": Box(0, 1, 4),
    "Endpoint": Box(1, 0),
    "Topic": Box(1, 1),
    "Service": Box(1, 2),
    "Action": Box(1, 3),
    "Parameter": Box(1, 4),
    "Hold": Box(2, 0, 1, INTERACTION),
    "Call": Box(2, 2, 1, INTERACTION),
    "Goal": Box(2, 3, 1, INTERACTION),
    "Property": Box(2, 4, 1, INTERACTION),
    "Message": Box(3, 0, 4),
    "Bag": Box(4, 0, 1, RECORDING),
    "Record": Box(4, 1, 1, RECORDING),
    "ServiceType": Box(0, 5, 1, TYPES),
    "MessageType": Box(1, 5, 1, TYPES),
    "ActionType": Box(2, 5, 1, TYPES),
    "Field": Box(3, 5, 1, TYPES),
}
NEIGHBOURS = (
    ("Node", "Topic"), ("Node", "Service"), ("Node", "Action"), ("Node", "Parameter"),
    ("Topic", "Endpoint"), ("Topic", "Hold"), ("Topic", "Message"), ("Hold", "Message"), ("Service", "Call"),
    ("Action", "Goal"), ("Call", "Message"), ("Goal", "Message"), ("Parameter", "Property"), ("Record", "Bag"),
    ("Record", "Message"), ("ServiceType", "MessageType"), ("ActionType", "MessageType"),
)  # fmt: skip
MOST = 4
"""The lines of properties that a box has room for, per row."""


class Relation(NamedTuple):
    """A property from a class to a class, both of which may be many."""

    name: str
    domains: tuple[str, ...]
    ranges: tuple[str, ...]
    inverse: str | None


def relations() -> Iterator[Relation]:
    """The object properties of the ontology's own namespace, by name."""
    triples = [each for name in OWN for each in module_triples(name)]
    kinds = {each.subject for each in triples if (each.predicate, each.object) == (rdf.type, owl.ObjectProperty)}
    said: dict[tuple[object, NamedNode], list[str]] = {}
    for subject, predicate, value in triples:
        if isinstance(value, NamedNode):
            said.setdefault((subject, predicate), []).append(_local(value))
    for node in sorted(kinds, key=str):
        if isinstance(node, NamedNode) and node.value.startswith(ros.iri):
            domains = chain(said.get((node, rdfs.domain), ()), said.get((node, schema_org.domainIncludes), ()))
            ranges = chain(said.get((node, rdfs.range), ()), said.get((node, schema_org.rangeIncludes), ()))
            (inverse,) = said.get((node, NamedNode(owl.iri + "inverseOf")), (None,))
            yield Relation(_local(node), tuple(domains), tuple(ranges), inverse)


def _local(term: NamedNode) -> str:
    return term.value.rpartition("#")[2]


def draw() -> str:
    """The picture as SVG."""
    found = list(relations())
    lines, inside = lines_between(found), _inside(found)
    width = max(box.x for box in BOXES.values()) + WIDTH + MARGIN
    height = max(box.y + box.height for box in BOXES.values()) + MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="12">',
        "<title>Main classes and properties of the ROS vocabulary of rosld</title>",
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>',
        *(each for pair, names in lines.items() for each in _line(pair, names)),
        *(each for name, box in BOXES.items() for each in _box(name, box, inside.get(name, []))),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def lines_between(found: Sequence[Relation]) -> dict[tuple[str, str], list[str]]:
    """The properties between neighbours, each with its inverse, told from the first to the second."""
    named = {each.name: each for each in found}
    inverse = {each.name: each.inverse for each in found if each.inverse} | {
        each.inverse: each.name for each in found if each.inverse
    }
    lines: dict[tuple[str, str], list[str]] = {pair: [] for pair in NEIGHBOURS}
    for (one, other), names in lines.items():
        told: set[str] = set()
        for each in found:
            forward = one in each.domains and other in each.ranges
            backward = other in each.domains and one in each.ranges
            back = inverse.get(each.name)
            is_named = back is not None and back in named
            if each.name in told or not (forward or (backward and not is_named)):
                continue
            told |= {each.name, *([back] if back else [])}
            words = f"{each.name} / {back}" if back else each.name
            names.append(_pointed(words, BOXES[one if forward else other], BOXES[other if forward else one]))
    return lines


def _pointed(words: str, start: Box, end: Box) -> str:
    """Words with an arrow from where a property starts to where it ends."""
    if start.column == end.column:
        return f"{words} {'↓' if start.row < end.row else '↑'}"
    return f"{words} →" if start.column < end.column else f"← {words}"


def _inside(found: Sequence[Relation]) -> dict[str, list[str]]:
    """The properties of classes whose ranges are no neighbours."""
    inside: dict[str, list[str]] = {}
    for each in found:
        for domain in each.domains:
            others = [one for one in each.ranges if not {(domain, one), (one, domain)} & {*NEIGHBOURS}]
            if domain in BOXES and others:
                inside.setdefault(domain, []).append(f"{each.name}: {', '.join(others)}")
    return inside


def _box(name: str, box: Box, words: Sequence[str]) -> Iterator[str]:
    yield (
        f'<rect x="{box.x:g}" y="{box.y:g}" width="{WIDTH}" height="{box.height:g}" rx="6" fill="{box.colour}" '
        'stroke="#4a5a6a"/>'
    )
    x, y = box.x + WIDTH / 2, box.y + 18
    yield f'<text x="{x:g}" y="{y:g}" text-anchor="middle" font-size="14" font-weight="bold">ros:{name}</text>'
    room = MOST * box.rows
    shown = [*words[: room - 1], "…"] if len(words) > room else words
    for number, each in enumerate(shown, 1):
        short = each if len(each) <= 31 else f"{each[:30]}…"
        y = box.y + 20 + number * LINE
        yield f'<text x="{box.x + 8:g}" y="{y:g}" font-size="11" fill="#333333">{escape(short)}</text>'


def _line(pair: tuple[str, str], names: Sequence[str]) -> Iterator[str]:
    """A line from edge to edge, with the properties above it."""
    one, other = (BOXES[name] for name in pair)
    if not names:
        return
    (x1, y1), (x2, y2) = _ends(one, other)
    yield f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="#4a5a6a"/>'
    x, y = (x1 + x2) / 2, (y1 + y2) / 2
    for number, each in enumerate(names):
        at = y - 5 - (len(names) - 1 - number) * LINE if x1 != x2 else y + 4 + number * LINE
        anchor, left = ("middle", x) if x1 != x2 else ("end", x - 6)
        yield (
            f'<text x="{left:g}" y="{at:g}" text-anchor="{anchor}" font-size="11" fill="#1f4e79" stroke="#ffffff" '
            f'stroke-width="3" paint-order="stroke">{escape(each)}</text>'
        )


def _ends(one: Box, other: Box) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where a line leaves one box and reaches the other."""
    if one.column == other.column:
        x = one.x + WIDTH / 2
        upper, lower = sorted((one, other), key=lambda box: box.y)
        return (x, upper.y + upper.height), (x, lower.y)
    left, right = (one, other) if one.column < other.column else (other, one)
    level = _level(left, right)
    first, second = (left.x + WIDTH, level[0]), (right.x, level[1])
    return (first, second) if left is one else (second, first)


def _level(left: Box, right: Box) -> tuple[float, float]:
    """The heights at which a line leaves and arrives: the same where the boxes overlap."""
    top, bottom = max(left.y, right.y), min(left.y + left.height, right.y + right.height)
    if top < bottom:
        return (top + bottom) / 2, (top + bottom) / 2
    return (
        min(max(right.y + right.height / 2, left.y), left.y + left.height),
        min(max(left.y + left.height / 2, right.y), right.y + right.height),
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8")
