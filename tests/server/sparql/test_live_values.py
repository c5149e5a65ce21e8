"""Resources of a robot that a query reads: only those that it names, with current values."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from rosld.adapters.base import Subscription
from tests.server.robots.asking import EX, TYPES, mapped
from tests.server.robots.made_up import ROBOT, MadeUp, Serving, served
from tests.waiting import once_started

pytestmark = pytest.mark.slow

POSE, TWIST, VECTOR, STRING = (
    "geometry_msgs/msg/Pose", "geometry_msgs/msg/Twist", "geometry_msgs/msg/Vector3", "std_msgs/msg/String"
)  # fmt: skip
PREFIXES = f"""
PREFIX ex: <{EX}> PREFIX t: <topics/> PREFIX string: <{TYPES}{STRING}#>
PREFIX pose: <{TYPES}{POSE}#> PREFIX twist: <{TYPES}{TWIST}#> PREFIX v: <{TYPES}{VECTOR}#>
"""
WING = """
<#plane> a map:ComplexResource ; map:path "/arm/" ; map:property [ map:predicate ex:wing ; map:member "grip" ] .
"""


class Touched(MadeUp):
    """A robot that records reads: `t:NAME` for topics, `p:NAME` for parameters, `grip` for its getter."""

    def __init__(self) -> None:
        super().__init__()
        self.opened: set[str] = set()
        self.variable("/arm/grip", "Byte", value=1)
        self.topic("/pose", POSE, {"position": {"x": 1.0}})
        self.topic("/cmd", TWIST, {"linear": {"x": 1.0}})
        self.topic("/chatter", STRING, {"data": "hello"})
        self.topic("/other", STRING, {"data": "hello"})
        self.parameter("/size", 3)

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        self.opened.add(topic)
        return await super().subscribe(topic, depth=depth)

    def clear(self) -> None:
        for each in (self.opened, self.calls, self.reads):
            each.clear()

    @property
    def touched(self) -> set[str]:
        names = {f"t:{name[1:]}" for name in self.opened} | {f"p:{name[1:]}" for name in self.reads if name != "/"}
        return names | {name.removeprefix("/arm/get_") for name in self.calls}


def ask(http: httpx.Client, query: str) -> list[str]:
    """Return the rows of a query with one column."""
    answer = once_started(
        lambda: http.post("/sparql", data={"query": PREFIXES + query}, headers={"Accept": "text/csv"})
    )
    assert answer.status_code == 200, answer.text
    return sorted(answer.text.split("\r\n")[1:-1])


EVERYTHING, TOPICS = "grip p:size t:chatter t:cmd t:other t:pose", "t:chatter t:cmd t:other t:pose"
NAMED = {
    "SELECT * { ?t a ros:Topic ; ros:hasMessageType ?type ; ros:publishedBy ?n }": "",
    "SELECT * { ?n a ros:Node ; ?p ?o }": EVERYTHING,
    "SELECT * { t:pose ros:publishedBy ?n }": "",
    'SELECT * { ?t ros:name "ros:latest # <topics/pose>" }': "",
    "SELECT * { ?x ^pose:position/^ros:latest ?t }": TOPICS,
    f"SELECT * {{ ?m a <{TYPES}{POSE}> ; pose:position ?x }}": "t:pose",
    f"SELECT * {{ ?m a <{TYPES}{POSE}> ; ?p ?o }}": EVERYTHING,
    f"SELECT * {{ ?t ros:hasMessageType <{TYPES}{POSE}> ; ros:rate ?r }}": "",
    f"BASE <{TYPES}a/b/c> SELECT * {{ ?m <../../geometry_msgs/msg/P\\u006Fse#position> ?x }}": "t:pose",
    "SELECT * { GRAPH ?g { ?t ros:rate ?r . ?m pose:position ?x } }": "t:pose",
    "SELECT * { ?m string:data ?x }": "t:chatter t:other",
    "SELECT * { t:other ros:latest ?m . ?m string:data ?x }": "t:chatter t:other",
    "SELECT * { GRAPH t:other { ?s ?p ?o } }": "t:other",
    "SELECT * FROM t:other { ?s ?p ?o }": "t:other",
    "DESCRIBE t:other": "t:other",
    "SELECT (ros:age(t:other) AS ?age) { }": "t:other",
    "SELECT * { VALUES ?t { t:other } GRAPH ?t { ?m string:data ?x } }": "t:chatter t:other",
    "SELECT * { ?a pose:position ?v . ?b string:data ?w }": "t:chatter t:other t:pose",
    "SELECT * { t:other ros:latest ?m { SELECT (MAX(?x) AS ?most) { ?m pose:position ?x } } }": "t:other t:pose",
    "SELECT * { ?p ros:name ?n ; ros:value ?v }": "p:size",
    "SELECT * { ?r a ros:Property ; rdf:value ?v }": EVERYTHING,
    "SELECT * { ?plane ex:wing ?w }": "grip",
    "SELECT * { <resources/arm/grip> rdf:value ?v }": "grip",
}
"""Queries, and the resources that they read."""


def test_a_query_reads_what_its_constants_can_match_and_no_more() -> None:
    wrong = {}
    for query, expected in NAMED.items():
        robot = Touched()
        with served(robot, freshness=0.0) as http:
            mapped(http, WING)
            robot.clear()
            answer = once_started(lambda text=query, http=http: http.post("/sparql", data={"query": PREFIXES + text}))
        assert answer.status_code == 200, (query, answer.text)
        if robot.touched != set(expected.split()):
            wrong[query] = robot.touched
    assert not wrong, wrong


def test_a_relation_counts_from_when_a_mapping_has_it(serving: Serving, robot: MadeUp) -> None:
    robot.variable("/arm/grip", "Byte", value=7)
    http = serving()
    query = "SELECT ?w { ?plane ex:wing ?w }"
    assert ask(http, query) == []
    mapped(http, WING)
    assert ask(http, query) == ["7"]
    assert http.delete("/mappings/mine").status_code == 204
    assert ask(http, query) == []


def test_a_query_sees_values_topics_and_parameters_as_they_are_now(serving: Serving, robot: MadeUp) -> None:
    robot.topic("/chatter", STRING, published=True)
    robot.topic("/broken", STRING, {"data": "well"})
    http = serving()
    for turn in range(3):
        robot.publishes("/chatter", {"data": f"turn {turn}"})
        robot.parameter("/size", turn)
        assert ask(http, "SELECT ?x { t:chatter ros:latest/string:data ?x }") == [f"turn {turn}"]
        assert ask(http, "SELECT ?x { <parameters/size> ros:value ?x }") == [str(turn)]
    robot.run(lambda: robot._put("/broken", ROBOT, b"\x07"))  # no message at all
    for query in ("SELECT ?x { ?m string:data ?x }", "SELECT ?x { ?m ?p ?x FILTER(?p = string:data) }"):
        assert ask(http, query) == ["turn 2"]
    robot.topic("/late", STRING, {"data": "late"})
    assert ask(http, "SELECT ?x { ?m string:data ?x }") == ["late", "turn 2"]
    robot.forget("/chatter")
    assert ask(http, "SELECT ?x { ?m string:data ?x }") == ["late"]
    assert ask(http, "SELECT ?g { GRAPH ?g { ?t ros:name '/chatter' } }") == []


def test_no_query_sees_a_message_in_part_or_another_s_answer(serving: Serving, robot: MadeUp) -> None:
    robot.topic("/cmd", TWIST, {"linear": {"x": 0.0}, "angular": {"z": 0.0}})
    http = serving()
    ask(http, "ASK {}")

    def look(turn: int) -> list[str]:
        robot.publishes("/cmd", {"linear": {"x": float(turn)}, "angular": {"z": float(turn)}})
        same = "?t ros:latest ?m . ?m twist:linear/v:x ?x ; twist:angular/v:z ?z BIND(STR(?x = ?z) AS ?same)"
        return ask(http, f"SELECT (CONCAT(?same, ' {turn}') AS ?found) {{ {same} }}")

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(look, range(40))) == [[f"true {turn}"] for turn in range(40)]
