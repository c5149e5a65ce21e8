"""The GeoSPARQL functions of queries have the results of Jena's: relations, distances in a plane and on the earth."""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import PREFIXES, geo
from rosld.server.sparql.ros_functions import functions
from tests.interop.java.maven import libraries

HERE = Path(__file__).parent
PATIENCE = 300.0
GEOF, METRE, DEGREE = PREFIXES["geof"], NamedNode(PREFIXES["uom"] + "metre"), NamedNode(PREFIXES["uom"] + "degree")
GREAT_CIRCLE = "http://jena.apache.org/function/spatial#greatCircleGeom"
FRAME = "<http://robot.example/frames#map> "
RELATIONS = ("sfWithin", "sfContains", "sfIntersects", "sfDisjoint", "sfTouches", "sfCrosses", "sfOverlaps", "sfEquals")
OWN = functions(lambda topic: None)


def ask_jena(expressions: list[str]) -> list[str]:
    """Return the lexical form of each result, empty for an error."""
    folder = libraries(HERE / "pom.xml")
    command = ["java", "-XX:+UseSerialGC", "-cp", f"{folder}/*", str(HERE / "Jena.java")]
    text = "\n".join(expressions)
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()


def expression(name: str, *arguments: Literal | NamedNode) -> str:
    return f"<{name}>({', '.join(map(str, arguments))})"


def call(name: str, *arguments: Literal | NamedNode) -> str:
    found = OWN[f"{GEOF}{name}"](*arguments)
    assert isinstance(found, Literal), (name, arguments)
    return found.value


def wkt(text: str) -> Literal:
    return Literal(text, datatype=geo.wktLiteral)


def shapes(chance: random.Random) -> list[str]:
    """Return a point, a line and a rectangle, at random and on corners and edges of each other; some with z and m."""

    def number() -> float:
        return chance.choice([chance.randrange(4), round(chance.uniform(-1, 5), 3)])

    x, y = number(), number()
    width, height = chance.choice((1, 2, 2.5)), chance.choice((1, 2, 2.5))
    corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y))
    return [
        f"POINT ZM({number()} {number()} 7 12.5)",
        f"LINESTRING({number()} {number()}, {number()} {number()}, {number()} {number()})",
        f"POLYGON Z(({', '.join(f'{a} {b} {number()}' for a, b in corners)}))",
    ]


def is_defined(name: str, one: str, other: str) -> bool:
    """Whether Simple Features defines a relation: what crosses has no higher dimension than what it crosses."""
    dimensions = {"POINT": 0, "LINESTRING": 1, "POLYGON": 2}
    first, second = (dimensions[each.split("(")[0].split()[0]] for each in (one, other))
    return name != "sfCrosses" or first <= second


def test_relations_and_distances_in_a_frame_are_those_of_a_plane() -> None:
    chance = random.Random(11)
    pairs = [(one, other) for _ in range(15) for one in shapes(chance) for other in shapes(chance)]
    questions = [(name, *pair) for pair in pairs for name in RELATIONS if is_defined(name, *pair)]
    judged = ask_jena(
        [
            *(expression(f"{GEOF}{name}", wkt(FRAME + one), wkt(FRAME + other)) for name, one, other in questions),
            *(expression(f"{GEOF}distance", wkt(one), wkt(other), DEGREE) for one, other in pairs),
        ]
    )
    assert len(judged) == len(questions) + len(pairs)
    assert {"true", "false"} <= set(judged)
    for (name, one, other), answer in zip(questions, judged, strict=False):
        assert call(name, wkt(FRAME + one), wkt(FRAME + other)) == answer, (name, one, other)
    for (one, other), answer in zip(pairs, judged[len(questions) :], strict=True):
        found = float(call("distance", wkt(FRAME + one), wkt(FRAME + other), METRE))
        assert found == pytest.approx(float(answer), abs=1e-9), (one, other)


def test_distances_on_the_earth_are_along_it() -> None:
    chance = random.Random(12)
    pairs = [
        [wkt(f"POINT({chance.uniform(-180, 180)} {chance.uniform(-90, 90)})") for _ in range(2)] for _ in range(100)
    ]
    judged = ask_jena([expression(GREAT_CIRCLE, *pair, METRE) for pair in pairs])
    for pair, answer in zip(pairs, judged, strict=True):
        assert float(call("distance", *pair, METRE)) == pytest.approx(float(answer), rel=1e-8)
