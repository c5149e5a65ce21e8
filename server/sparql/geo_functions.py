"""GeoSPARQL functions for places in frames, which the store has for WGS84 only, and `ros:transform`. Pure.

A frame is a plane here, seen from above along its z axis, as Simple Features has it. Functions raise ValueError or
LookupError for invalid arguments, such as geometries of different coordinate reference systems.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple
from urllib.parse import unquote

from pyoxigraph import Literal, NamedNode, QuerySolutions, Store

from rosld.ontology.geometry import CRS84, frame_iri
from rosld.ontology.vocab import PREFIXES, geo, xsd
from rosld.server.dataset.base import Term
from rosld.server.space.transforms import FrameBuffer, Vector, apply

GEOF = PREFIXES["geof"]
_METRES = frozenset({PREFIXES["uom"] + "metre", PREFIXES["unit"] + "M"})
_EARTH_RADIUS = 6371008.8
"""Mean radius of the earth in metres (IUGG), as the store takes it."""
_WKT = re.compile(r"\s*(?:<([^<>\s]*)>)?\s*([A-Za-z]+?)\s*(Z|M|ZM)?\s*(\([0-9eE.,()+\-\s]*\))\s*", re.IGNORECASE)
_INNERMOST = re.compile(r"[^()]*\d[^()]*")
_COORDINATE = re.compile(r"[^(),]*\d[^(),]*")
Ring = Sequence[tuple[float, float]]


class _Place(NamedTuple):
    """A parsed geo:wktLiteral; `body` is the text from its first parenthesis."""

    crs: str
    kind: str
    tag: str
    body: str

    @property
    def parts(self) -> Sequence[Ring]:
        """The points, lines or rings, without z and m."""
        return _parts(self.body)

    @property
    def plain(self) -> str:
        """The text without its coordinate reference system."""
        return f"{self.kind}{self.tag and ' ' + self.tag}{self.body}"


def _place(term: Term) -> _Place:
    if not isinstance(term, Literal) or term.datatype != geo.wktLiteral:
        raise ValueError("not a geometry")
    found = _WKT.fullmatch(term.value)
    if found is None:
        raise ValueError("not WKT")
    return _Place(found[1] or CRS84, found[2].upper(), (found[3] or "").upper(), found[4])


@lru_cache(maxsize=1024)
def _parts(body: str) -> Sequence[Ring]:
    lines = ([each.split() for each in line.split(",") if each.strip()] for line in _INNERMOST.findall(body))
    return [[(float(one[0]), float(one[1])) for one in line] for line in lines]


def _pair(one: Term, other: Term) -> tuple[_Place, _Place]:
    places = _place(one), _place(other)
    if places[0].crs != places[1].crs:
        raise ValueError("different coordinate reference systems")
    return places


# --- relations

_QUICK: Mapping[str, Callable[[int], bool]] = {
    "sfWithin": lambda side: side > 0,
    "sfIntersects": lambda side: side >= 0,
    "sfDisjoint": lambda side: side < 0,
}
"""Relations of a point to a polygon, by `_side`."""
_RELATIONS = (*_QUICK, "sfContains", "sfCrosses", "sfEquals", "sfOverlaps", "sfTouches")


def _relate(name: str, one: Term, other: Term) -> Term:
    """Return a relation of Simple Features, by the store's function, which takes WGS84 for a plane, too."""
    return Literal(_holds(name, *_pair(one, other)))


def _holds(name: str, one: _Place, other: _Place) -> bool:
    if name == "sfContains":
        return _holds("sfWithin", other, one)
    if name in _QUICK and (one.kind, other.kind) == ("POINT", "POLYGON"):  # 5 us instead of 170
        return _QUICK[name](_side(one.parts[0][0], other.parts))
    arguments = ", ".join(f'"{each.plain}"^^{geo.wktLiteral}' for each in (one, other))
    found = Store().query(f"SELECT (<{GEOF}{name}>({arguments}) AS ?x) {{}}")
    assert isinstance(found, QuerySolutions)
    (term,) = next(found)
    if not isinstance(term, Literal):
        raise ValueError("not related")
    return term.value == "true"


def _side(point: tuple[float, float], rings: Sequence[Ring]) -> int:
    """Return 1 for a point inside of a polygon, 0 on its boundary, -1 outside."""
    x, y = point
    is_inside = False
    for ring in rings:
        for (ax, ay), (bx, by) in pairwise(ring):
            if not (min(ay, by) <= y <= max(ay, by)):
                continue
            turn = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            if turn == 0 and min(ax, bx) <= x <= max(ax, bx):
                return 0
            if (ay > y) != (by > y) and (turn > 0) == (by > ay):
                is_inside = not is_inside
    return 1 if is_inside else -1


# --- distances


def distance(one: Term, other: Term, unit: Term) -> Term:
    """`geof:distance`: metres between geometries of one frame, or along the earth between two points."""
    if not isinstance(unit, NamedNode) or unit.value not in _METRES:
        raise ValueError("not metres")
    first, second = _pair(one, other)
    if first.kind == second.kind == "POINT":
        a, b = first.parts[0][0], second.parts[0][0]
        return Literal(_great_circle(a, b) if first.crs == CRS84 else math.dist(a, b))
    if first.crs == CRS84:
        raise ValueError("not two points on the earth")
    if _holds("sfIntersects", first, second):
        return Literal(0.0)
    return Literal(min(_nearest(first.parts, second.parts), _nearest(second.parts, first.parts)))


def _great_circle(one: tuple[float, float], other: tuple[float, float]) -> float:
    (x, y), (u, v) = (tuple(map(math.radians, each)) for each in (one, other))
    share = math.sin((v - y) / 2) ** 2 + math.cos(y) * math.cos(v) * math.sin((u - x) / 2) ** 2
    return 2 * _EARTH_RADIUS * math.asin(math.sqrt(min(1.0, share)))


def _nearest(ends: Sequence[Ring], lines: Sequence[Ring]) -> float:
    """Return the least distance of a point of `ends` to a line; a line may be a single point."""
    points = [point for ring in ends for point in ring]
    found = math.inf
    for line in lines:
        for (x, y), (u, v) in zip(line, line[1:] or line, strict=False):
            over, up = u - x, v - y
            square = over * over + up * up or 1.0
            for a, b in points:
                share = min(1.0, max(0.0, ((a - x) * over + (b - y) * up) / square))
                found = min(found, math.hypot(a - x - share * over, b - y - share * up))
    return found


# --- transforms


def transform(buffer: FrameBuffer, frames: str, place: Term, target: Term) -> Term:
    """`ros:transform(?wkt, "map")`: a place in another frame, at the time that is its M coordinate.

    Without M that is the latest time for which there is a transform. `frames` is the URL of the robot's frames.
    """
    found = _place(place)
    own, _, source = found.crs.partition("#")
    if isinstance(target, NamedNode):
        document, _, name = target.value.partition("#")
        is_frame, name = document == frames, unquote(name)
    else:
        is_frame, name = isinstance(target, Literal) and target.datatype == xsd.string, getattr(target, "value", "")
    if own != frames or not source or not is_frame:
        raise ValueError("not a frame of this robot")
    has_stamp = "M" in found.tag

    def moved(match: re.Match[str]) -> str:
        numbers = match[0].split()
        *place, stamp = numbers if has_stamp else (*numbers, None)
        at = None if stamp is None else int(Decimal(stamp).scaleb(9))
        x, y, z = map(float, place if len(place) > 2 else (*place, 0.0))
        vector: Vector = apply(buffer.look_up(name, unquote(source), at), (x, y, z))
        return " ".join([*map(repr, vector), *([stamp] if stamp is not None else [])])

    text = f"{found.kind} Z{'M' if has_stamp else ''}{_COORDINATE.sub(moved, found.body)}"
    return Literal(f"<{frame_iri(frames, name.removeprefix('/'))}> {text}", datatype=geo.wktLiteral)


FUNCTIONS: Mapping[str, Callable[..., Term]] = {
    f"{GEOF}distance": distance,
    **{f"{GEOF}{name}": partial(_relate, name) for name in _RELATIONS},
}
