"""Resources below `/resources/` in queries: present in a query that names them, also by a class or a predicate."""

from __future__ import annotations

import csv
import io
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving

pytestmark = pytest.mark.slow

EX, mapped = asking.EX, asking.mapped
READ_DEADLINE = 1.0
"""Timeout of a getter in seconds; an answering one takes little even on a busy machine."""
HAND = """
<#hand> a map:ComplexResource ; map:path "/arm/hand/" ; map:existsWhen <#manual> ;
  map:property [ map:predicate ex:width ; map:member "width" ] ;
  map:action [ map:relation ex:greet ; map:service "/arm/hand/wave" ] .
<#manual> a sh:NodeShape ; map:about "/arm/mode" ; sh:property [ sh:path rdf:value ; sh:hasValue "manual" ] .
"""


@pytest.fixture
def arm(robot: MadeUp) -> MadeUp:
    """An arm with a hand."""
    robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/mode", "Words", words="manual")
    robot.variable("/arm/hand/width", "Byte", value=9)
    robot.answer("/arm/hand/wave", "std_srvs/srv/Trigger", success=True)
    return robot


def found(http: httpx.Client, where: str) -> set[str]:
    """Return the single column of a SELECT, as paths or words, without duplicates."""
    query = f"PREFIX ex: <{EX}> PREFIX td: <https://www.w3.org/2019/wot/td#> SELECT ?x {{ {where} }}"
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    rows = [row[0].removeprefix(str(http.base_url)) for row in list(csv.reader(io.StringIO(answer.text)))[1:]]
    assert len(rows) == len(set(rows)), f"found twice: {rows}"
    return set(rows)


def getters(robot: MadeUp) -> set[str]:
    """Return the getters that were called."""
    return {name for name, count in robot.calls.items() if count and "/get_" in name}


def test_resources_are_found_by_class_predicate_and_name(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    containers = {"resources/", "resources/arm/", "resources/arm/hand/"}
    properties = {"resources/arm/grip", "resources/arm/mode", "resources/arm/hand/width"}
    values = {"1", "manual", "9"}
    for where, expected in {
        "?x a ros:ComplexResource": containers,
        "GRAPH ?x { ?x a ros:ComplexResource }": containers,
        "?r a ros:ComplexResource ; ros:name ?x": {"/", "/arm", "/arm/hand"},
        "?r ros:name '/arm' . ?r ldp:contains ?x . ?x a ros:ComplexResource": {"resources/arm/hand/"},
        "?x a ros:Property": properties,
        "?x ros:readsFrom ?any": properties,
        "?x ros:writesTo <services/arm/set_grip>": {"resources/arm/grip"},
        "?p a ros:Property ; rdf:value ?x": values,
        "?p rdf:value ?x": values,
        "?x ros:invokes ?service": {"resources/arm/hand/wave"},
        "GRAPH ?g { ?a a td:ActionAffordance } ?a td:name ?x FILTER(?g != <resources/arm/hand/>)": {"wave", "stop"},
        "?x td:hasActionAffordance ?any": {"resources/arm/hand/", "resources/arm/hand/wave", "stop"},
    }.items():
        assert found(http, where) == expected, where
    for number in (3, 7):
        assert http.put("/resources/arm/grip", json=number).status_code == 204
        assert str(number) in found(http, "?p a ros:Property ; rdf:value ?x"), "values are as of each query"


def test_a_resource_whose_condition_does_not_hold_is_in_no_answer(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, HAND)
    for word, width, greeting in (("manual", {"9"}, {"resources/arm/hand/"}), ("automatic", set(), set())):
        assert http.put("/resources/arm/mode", json=word).status_code == 204
        assert found(http, "?hand ex:width ?x") == width
        assert found(http, "?x ex:greet ?action") == greeting
        assert ("resources/arm/hand/" in found(http, "?x a ros:ComplexResource")) is (word == "manual")


def stuck(arm: MadeUp) -> list[str]:
    """Thirty getters that hang."""
    names = [f"/arm/get_stuck{number}" for number in range(30)]
    for value, name in enumerate(names, 20):
        arm.variable(name.replace("get_", ""), "Byte", value=value)
        arm.hold(name)
    return names


def test_getters_that_hang_are_waited_for_together_and_then_left_out(arm: MadeUp, serving: Serving) -> None:
    names = stuck(arm)
    http = serving(read_deadline=READ_DEADLINE)
    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(found, http, "?p a ros:Property ; rdf:value ?x")
        arm.until(lambda: all(arm.calls[name] for name in names), "all calls, while none is answered")
        assert "9" in asking.result()
    assert len(found(http, "?x a ros:Property ; ros:unreadable ?why")) == 30
    for name in names:
        arm.release(name)
