"""GeoSPARQL in frames and in WGS84, and ros:transform: results of the formulas, of the store and of tf2."""

from __future__ import annotations

import math
import random

import pytest
from pyoxigraph import Literal, NamedNode, QuerySolutions, Store

from rosld.ontology.vocab import PREFIXES, geo, ros
from rosld.server.space.transforms import FrameBuffer
from rosld.server.sparql.ros_functions import functions
from tests.server.space.test_frame_buffer import SAMPLE, SECOND, UPRIGHT, message

BASE = "http://robot.example/"
FRAMES = f"{BASE}frames#"
GEOF, METRE = PREFIXES["geof"], NamedNode(PREFIXES["uom"] + "metre")
SQUARE = "POLYGON((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 2 1, 2 2, 1 2, 1 1))"
OWN = functions(lambda topic: None)


def wkt(text: str, frame: str | None = "map") -> Literal:
    return Literal(text if frame is None else f"<{FRAMES}{frame}> {text}", datatype=geo.wktLiteral)


def call(name: str, *arguments: Literal | NamedNode) -> object:
    """Return the value of a function, None for an error."""
    found = OWN[f"{GEOF}{name}"](*arguments)
    assert found is None or isinstance(found, Literal)
    return None if found is None else float(found.value) if name == "distance" else found.value == "true"


def of_the_store(name: str, *arguments: Literal | NamedNode) -> object:
    found = Store().query(f"SELECT (<{GEOF}{name}>({', '.join(map(str, arguments))}) AS ?x) {{}}")
    assert isinstance(found, QuerySolutions)
    (term,) = next(found)
    assert isinstance(term, Literal)
    return float(term.value) if name == "distance" else term.value == "true"


def test_a_frame_is_a_plane() -> None:
    assert call("distance", wkt("POINT Z(0 0 5)"), wkt("POINT ZM(3 4 1 12.5)"), METRE) == 5
    assert call("distance", wkt("POINT(5 0)"), wkt(SQUARE), METRE) == 1
    assert call("distance", wkt("POINT(1.5 1.4)"), wkt(SQUARE), METRE) == pytest.approx(0.4)
    assert call("distance", wkt("POINT(3 3)"), wkt(SQUARE), METRE) == 0
    assert call("distance", wkt("LINESTRING(5 -5, 5 5)"), wkt(SQUARE), METRE) == 1
    assert call("distance", wkt("POINT(7 8)"), wkt("LINESTRING(0 0, 4 4)"), METRE) == 5
    assert call("sfWithin", wkt("POINT ZM(3 3 0 1)"), wkt(SQUARE)) is True
    assert [call("sfWithin", wkt(f"POINT({x} 1.5)"), wkt(SQUARE)) for x in (0, 0.5, 1, 1.5, 9)] == [
        *(False, True, False, False, False)
    ]
    assert call("sfContains", wkt(SQUARE), wkt("POINT(3 3)")) is True
    assert call("sfTouches", wkt("POINT(0 2)"), wkt(SQUARE)) is True


def test_what_cannot_be_compared_is_an_error() -> None:
    assert call("distance", wkt("POINT(0 0)"), wkt("POINT(0 1)", "odom"), METRE) is None
    assert call("sfWithin", wkt("POINT(0 0)", "odom"), wkt(SQUARE)) is None
    assert call("distance", wkt("POINT(0 0)"), wkt("POINT(0 1)", None), METRE) is None
    assert call("distance", wkt("POINT(0 0)"), wkt("POINT(0 1)"), NamedNode(PREFIXES["uom"] + "degree")) is None
    for text in ("POINT", "POINT()", "POINT(a b)", "POINT(1 1", 'POINT(1 1)"', "CIRCLE(1 1)", "POINT EMPTY", ""):
        assert call("sfWithin", wkt(text), wkt(SQUARE)) is None, text
        assert call("distance", wkt(text), wkt("POINT(0 0)"), METRE) in (None, math.sqrt(2)), text


def test_random_relations_are_those_of_the_store() -> None:
    chance = random.Random(3)
    for _ in range(200):
        point = f"POINT({chance.choice([chance.randrange(5), chance.uniform(-1, 5)])} {chance.uniform(-1, 5)})"
        line = f"LINESTRING({chance.uniform(-1, 5)} 1, {chance.randrange(5)} {chance.uniform(-1, 5)})"
        for name in ("sfWithin", "sfIntersects", "sfDisjoint", "sfTouches", "sfCrosses"):
            for text in (point, line):
                judge = of_the_store(name, wkt(text, None), wkt(SQUARE, None))
                assert call(name, wkt(text), wkt(SQUARE)) == judge, (name, text)


def test_distances_on_the_earth_are_those_of_the_store() -> None:
    chance = random.Random(4)
    for _ in range(100):
        ends = [wkt(f"POINT({chance.uniform(-180, 180)} {chance.uniform(-90, 90)})", None) for _ in range(2)]
        assert call("distance", *ends, METRE) == pytest.approx(of_the_store("distance", *ends, METRE), rel=1e-9)


def transformed(buffer: FrameBuffer, text: str, frame: str, target: str | NamedNode) -> str | None:
    term = Literal(target) if isinstance(target, str) else target
    found = functions(lambda topic: None, BASE, buffer.rows())[ros.transform.value](wkt(text, frame), term)
    assert found is None or isinstance(found, Literal)
    return None if found is None else found.value


def test_a_place_moves_to_another_frame_at_its_own_time() -> None:
    buffer = FrameBuffer()
    for at in (10, 12):
        buffer.add(message(("map", "odom", at * SECOND, (at, 0, 0), UPRIGHT)), SAMPLE, is_static=False)
    buffer.add(message(("odom", "arm 1", 0, (0, 5, 0), UPRIGHT)), SAMPLE, is_static=True)
    assert transformed(buffer, "POINT ZM(1 2 3 11)", "arm%201", "map") == f"<{FRAMES}map> POINT ZM(12.0 7.0 3.0 11)"
    assert transformed(buffer, "POINT(1 2)", "odom", "/map") == f"<{FRAMES}map> POINT Z(13.0 2.0 0.0)"
    assert transformed(buffer, "POINT Z(1 2 3)", "odom", NamedNode(f"{FRAMES}arm%201")) == (
        f"<{FRAMES}arm%201> POINT Z(1.0 -3.0 3.0)"
    )
    assert transformed(buffer, "POLYGON((0 0, 1 0, 1 1, 0 0))", "arm%201", "odom") == (
        f"<{FRAMES}odom> POLYGON Z((0.0 5.0 0.0,1.0 5.0 0.0,1.0 6.0 0.0,0.0 5.0 0.0))"
    )
    for text, frame, target in (
        ("POINT ZM(1 2 3 9.999999999)", "odom", "map"),
        ("POINT ZM(1 2 3 12.000000001)", "odom", "map"),
        ("POINT Z(1 2 3)", "odom", "moon"),
        ("POINT Z(1 2 3)", "moon", "map"),
    ):
        assert transformed(buffer, text, frame, target) is None
    assert transformed(buffer, "POINT Z(1 2 3)", "odom", NamedNode("http://other.example/frames#map")) is None
    for at in (10, 12):
        assert (
            transformed(buffer, f"POINT ZM(0 0 0 {at})", "odom", "map")
            == f"<{FRAMES}map> POINT ZM({at}.0 0.0 0.0 {at})"
        )
