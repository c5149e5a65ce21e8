"""Updates of a robot that fails, refuses and changes meanwhile: no response is wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import httpx
import pytest

from rosld.adapters.base import Published
from rosld.adapters.model import Refused, Sent, TimedOut, TypeRef
from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.waiting import until

pytestmark = pytest.mark.slow

value, detail, mapped = asking.value, asking.detail, asking.mapped
TYPES, TURTLE, UPDATE, MERGE = asking.TYPES, asking.TURTLE, asking.UPDATE, asking.MERGE
PREFIXES = f"PREFIX rdf: <{asking.RDF}> PREFIX ros: <{asking.ROS}> PREFIX ex: <{asking.EX}> "


def update(http: httpx.Client, text: str, **query: str) -> httpx.Response:
    """Send an update."""
    return http.post("/sparql", content=PREFIXES + text, headers=UPDATE, params=query)


def fates(answer: httpx.Response) -> dict[str, str]:
    """Return the outcome for each graph, by its path."""
    base = str(answer.url.join("/"))
    return {"/" + each["graph"].removeprefix(base): each["outcome"] for each in answer.json()["graphs"]}


def seen(http: httpx.Client, path: str, predicate: str = "rdf:value") -> list[str]:
    """Return the current values in the graph of a resource, as in a query."""
    query = f"{PREFIXES} SELECT ?v {{ GRAPH <{path}> {{ ?s {predicate} ?v }} }}"
    answer = http.get("/sparql", params={"query": query}, headers={"Accept": "application/sparql-results+json"})
    return [row["v"]["value"] for row in answer.json()["results"]["bindings"]]


def to(path: str, new: object, predicate: str = "rdf:value") -> str:
    """Return an operation that sets the value in the graph of a resource."""
    return (
        f"DELETE {{ GRAPH <{path}> {{ ?s {predicate} ?old }} }} INSERT {{ GRAPH <{path}> {{ ?s {predicate} {new} }} }} "
        f"WHERE {{ GRAPH <{path}> {{ ?s {predicate} ?old }} }}"
    )


GRIPS = ("/resources/arm/first", "/resources/arm/second", "/resources/arm/third")
ALL = "INSERT DATA { GRAPH </data/note> { <urn:a> <urn:b> 'stored' } } ; " + " ; ".join(to(path, 7) for path in GRIPS)


@pytest.fixture
def arm(robot: MadeUp) -> MadeUp:
    """An arm with three members."""
    for name in ("first", "second", "third"):
        robot.variable(f"/arm/{name}", "Byte", value=1)
    return robot


def refuses(_: object) -> Mapping[str, Any]:
    """Refuse, as a setter."""
    raise Refused("/arm/set_second refused: it is jammed")


# The robot fails part-way


@pytest.mark.parametrize(
    ("failure", "status", "fate", "words"),
    [
        ("refuses", 422, "failed", "it is jammed"),
        ("hangs", 504, "unknown", "did not respond"),
        ("has died", 503, "failed", "does not answer"),
    ],
)
def test_a_robot_that_fails_part_way_is_told_graph_by_graph(
    arm: MadeUp, serving: Serving, failure: str, status: int, fate: str, words: str
) -> None:
    http = serving(call_deadline=1.0)
    if failure == "refuses":
        arm.offer("/arm/set_second", "made_up/srv/SetByte", refuses)
    elif failure == "hangs":
        arm.hold("/arm/set_second")
    else:
        arm.break_off("/arm/set_second")
    answer = update(http, ALL)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.json()["detail"]
    assert fates(answer) == {"/data/note": "done", GRIPS[0]: "done", GRIPS[1]: fate, GRIPS[2]: "not attempted"}
    [failed] = [each for each in answer.json()["graphs"] if "status" in each]
    assert failed["status"] == status
    assert words in failed["detail"]
    assert seen(http, "/data/note", "<urn:b>") == ["stored"]
    assert [seen(http, path) for path in GRIPS] == [["7"], ["1"], ["1"]]
    assert arm.calls["/arm/set_third"] == 0
    if failure == "hangs":
        arm.release("/arm/set_second")


def test_what_was_unknown_is_read_anew(arm: MadeUp, serving: Serving) -> None:
    """The setter succeeds, but its answer is lost."""
    values = {"value": 1}

    def lost(request: dict[str, Any]) -> Mapping[str, Any]:
        values.update(request)
        raise TimedOut("/arm/set_first did not respond", sent=Sent.MAYBE)

    arm.offer("/arm/get_first", "made_up/srv/GetByte", lambda _: values)
    arm.offer("/arm/set_first", "made_up/srv/SetByte", lost)
    http = serving(freshness=60)
    assert seen(http, GRIPS[0]) == ["1"]
    answer = update(http, to(GRIPS[0], 7))
    assert answer.status_code == 504
    assert fates(answer) == {GRIPS[0]: "unknown"}
    assert seen(http, GRIPS[0]) == ["7"]


def test_a_publish_that_nobody_hears_is_202_with_the_report() -> None:
    class Deaf(MadeUp):  # type: ignore[misc,valid-type]
        """A robot without subscribers at the time of publishing."""

        async def publish(
            self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
        ) -> Published:
            await super().publish(topic, type, data, latch=latch, deadline=deadline)
            return Published(0)

    robot = Deaf()
    robot.topic("/lamp", "std_msgs/msg/String", published=False, heard=True)
    robot.parameter("/size", 3)
    with served(robot) as http:
        text = (
            f"INSERT DATA {{ GRAPH </topics/lamp> {{ </topics/lamp#message> a <{TYPES}std_msgs/msg/String> ; "
            f"<{TYPES}std_msgs/msg/String#data> 'on' }} }} ; {to('/parameters/size', 4, 'ros:value')}"
        )
        answer = update(http, text)
        assert answer.status_code == 202, answer.text
        assert fates(answer) == {"/topics/lamp": "unheard", "/parameters/size": "done"}
        assert robot.sent == {"/lamp": [{"data": "on"}]}
        assert seen(http, "/parameters/size", "ros:value") == ["4"]


# Concurrent changes


def test_what_was_read_and_changes_before_it_is_carried_out_is_drawn_again(arm: MadeUp, serving: Serving) -> None:
    turns = iter([1, 2, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3])
    arm.offer("/arm/get_first", "made_up/srv/GetByte", lambda _: {"value": next(turns)})
    http = serving(freshness=0)
    text = (
        f"INSERT {{ GRAPH </data/copy> {{ <urn:a> <urn:b> ?v }} }} WHERE {{ GRAPH <{GRIPS[0]}> {{ ?s rdf:value ?v }} }}"
    )
    assert update(http, text).status_code == 204
    assert seen(http, "/data/copy", "<urn:b>") == ["3"]


def test_what_changes_without_end_is_409_and_nothing_is_done(arm: MadeUp, serving: Serving) -> None:
    turns = count()
    arm.offer("/arm/get_first", "made_up/srv/GetByte", lambda _: {"value": next(turns) % 100})
    http = serving(freshness=0)
    text = (
        f"INSERT {{ GRAPH </data/copy> {{ <urn:a> <urn:b> ?v }} }} WHERE {{ GRAPH <{GRIPS[0]}> {{ ?s rdf:value ?v }} }}"
        f" ; {to(GRIPS[1], 9)}"
    )
    answer = update(http, text)
    assert "changed 4 times" in detail(answer, 409)
    assert answer.headers["retry-after"] == "1"
    assert http.get("/data/copy").status_code == 404
    assert arm.calls["/arm/set_second"] == 0
    assert seen(http, GRIPS[1]) == ["1"]


def test_topics_that_an_update_does_not_name_go_on_meanwhile(arm: MadeUp, serving: Serving) -> None:
    arm.topic("/place", "geometry_msgs/msg/Vector3", {"x": 1, "y": 0, "z": 0})

    def moving(_: Any) -> dict[str, int]:
        arm.publishes("/place", {"x": 1, "y": 0, "z": 0})
        return {"value": 1}

    arm.offer("/arm/get_first", "made_up/srv/GetByte", moving)
    http = serving(freshness=0)
    assert http.get("/topics/place").status_code == 200  # it is subscribed to
    vector = "<https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#x>"
    grip = f"GRAPH <{GRIPS[0]}> {{ ?s rdf:value ?grip }}"
    into = "INSERT { GRAPH </data/copy> { <urn:a> <urn:b> ?v } } WHERE"
    assert update(http, f"{into} {{ ?m {vector} ?v . {grip} }}").status_code == 204
    assert seen(http, "/data/copy", "<urn:b>") == ["1.0"]
    named = update(http, f"{into} {{ GRAPH </topics/place> {{ ?m {vector} ?v }} {grip} }}")
    assert "changed 4 times" in detail(named, 409)


# Refusals


DOOR = """
<#door> a map:ComplexResource ; map:path "/door/" ;
  map:property [ map:predicate ex:lock ; map:member "lock" ] ;
  map:property [ map:predicate ex:light ; map:member "light" ; map:writableWhen <#unlocked> ] .
<#unlocked> a sh:NodeShape ; map:about "/door/" ; sh:property [ sh:path ex:lock ; sh:hasValue "open" ] .
"""


def test_a_mapping_s_conditions_hold_for_updates(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/door/lock", "Words", words="shut")
    robot.variable("/door/light", "Byte", value=1)
    http = serving(freshness=0)
    mapped(http, DOOR)
    answer = update(
        http, f"INSERT DATA {{ GRAPH </data/x> {{ <urn:a> <urn:b> 1 }} }} ; {to('/resources/door/light', 2)}"
    )
    assert "must not be written now" in detail(answer, 409)
    assert [each["graph"].partition("/resources")[2] for each in answer.json()["graphs"]] == ["/door/light"]
    assert http.get("/data/x").status_code == 404
    assert robot.calls["/door/set_light"] == 0
    through = update(http, to("/resources/door/", 2, "ex:light"))
    assert "must not be written now" in detail(through, 409)
    assert update(http, to("/resources/door/lock", "'open'")).status_code == 204
    assert update(http, to("/resources/door/light", 2)).status_code == 204
    assert update(http, to("/resources/door/", 3, "ex:light")).status_code == 204
    assert value(http, "/resources/door/light") == 3


def test_a_value_beyond_its_limits_is_422_with_its_violations(arm: MadeUp, serving: Serving, tmp_path: Path) -> None:
    limits = tmp_path / "limits.ttl"
    limits.write_text(
        f"@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{asking.RDF}> .\n"
        "<#grip> a sh:NodeShape ; sh:targetNode <resources/arm/second> ;"
        " sh:property [ sh:path rdf:value ; sh:maxInclusive 5 ] ."
    )
    http = serving(shapes=(limits,))
    answer = update(http, ALL)
    assert answer.status_code == 422, answer.text
    assert answer.json()["violations"]
    assert [each["graph"].partition("/arm/")[2] for each in answer.json()["graphs"]] == ["second"]
    assert http.get("/data/note").status_code == 404
    assert [seen(http, path) for path in GRIPS] == [["1"]] * 3


def test_the_members_of_a_complex_resource_are_written_through_its_graph(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/door/lock", "Words", words="shut")
    robot.variable("/door/light", "Byte", value=1)
    http = serving(freshness=0)
    mapped(http, DOOR.replace(" ; map:writableWhen <#unlocked>", ""))
    text = (
        "WITH </resources/door/> DELETE { ?d ex:lock ?lock ; ex:light ?light } "
        "INSERT { ?d ex:lock 'open' ; ex:light 5 } WHERE { ?d ex:lock ?lock ; ex:light ?light }"
    )
    assert update(http, text).status_code == 204
    assert value(http, "/resources/door/") == {"lock": "open", "light": 5}
    assert robot.calls["/door/set_lock"] == robot.calls["/door/set_light"] == 1
    gone = update(http, "DELETE WHERE { GRAPH </resources/door/> { ?d ex:light ?light } }")
    assert "cannot be removed" in detail(gone, 422)


def test_what_is_closed_is_closed_to_updates(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/closed/lamp", "std_msgs/msg/String", published=False, heard=True)
    robot.parameter("/closed/size", 3)
    http = serving(resources_only=("/closed/*",))
    for text in (to("/parameters/closed/size", 4, "ros:value"), lit("/closed/lamp", "on")):
        answer = update(http, f"INSERT DATA {{ GRAPH </data/x> {{ <urn:a> <urn:b> 1 }} }} ; {text}")
        assert "/resources/" in detail(answer, answer.status_code)
        assert answer.status_code in (403, 409)
    assert http.get("/data/x").status_code == 404
    assert value(http, "/parameters/closed/size") == 3
    assert robot.sent == {}


def lit(topic: str, words: str) -> str:
    """Return an operation that publishes another message on a topic, whatever the last one was."""
    graph, string = f"/topics{topic}", f"{TYPES}std_msgs/msg/String"
    return (
        f"DELETE {{ GRAPH <{graph}> {{ ?m ?p ?o }} }} INSERT {{ GRAPH <{graph}> {{ <{graph}#message> a <{string}> ; "
        f"<{string}#data> '{words}' }} }} WHERE {{ OPTIONAL {{ GRAPH <{graph}> {{ ?m ?p ?o "
        f"FILTER(?m = <{graph}#message>) }} }} }}"
    )


def test_the_publish_rate_holds_for_updates(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/lamp", "std_msgs/msg/String", published=False, heard=True)
    http = serving(max_publish_rate=1.0)
    for turn in range(50):
        answer = update(http, lit("/lamp", str(turn)))
        if answer.status_code != 204:
            break
    assert "--max-publish-rate" in detail(answer, 429)
    assert int(answer.headers["retry-after"]) > 0
    assert fates(answer) == {"/topics/lamp": "failed"}
    assert [each["data"] for each in robot.sent["/lamp"]] == [str(each) for each in range(turn)]
    assert value(http, "/topics/lamp") == {"data": str(turn - 1)}


# Side effects on stored documents


def test_a_mapping_that_an_update_stores_is_in_force_and_a_bad_one_refuses_it_all(
    robot: MadeUp, serving: Serving
) -> None:
    robot.variable("/door/lock", "Words", words="shut")
    robot.variable("/door/light", "Byte", value=1)
    http = serving(freshness=0)
    mapping = "PREFIX map: <https://w3id.org/rosld/mapping#> "
    good = (
        "INSERT DATA { GRAPH </mappings/mine> { <#door> a map:ComplexResource ; map:path '/gate/' ; "
        "map:property [ map:predicate ex:light ; map:member '/door/light' ] } }"
    )
    stored = update(http, mapping + good)
    assert stored.status_code == 204, stored.text
    assert value(http, "/resources/gate/") == {"light": 1}
    bad = (
        "INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> 1 } } ; DELETE WHERE { GRAPH </mappings/mine> "
        f"{{ ?s map:path ?path }} }} ; {to('/resources/door/light', 5)}"
    )
    refused = update(http, mapping + bad)
    assert refused.status_code in (409, 422), refused.text
    assert http.get("/data/never").status_code == 404
    assert value(http, "/resources/gate/") == {"light": 1}
    assert robot.calls["/door/set_light"] == 0


def test_the_members_of_direct_containers_are_told_of_their_resource(serving: Serving) -> None:
    http = serving()
    direct = '<http://www.w3.org/ns/ldp#DirectContainer>; rel="type"'
    body = (
        "@prefix ldp: <http://www.w3.org/ns/ldp#> . <> ldp:membershipResource <> ; ldp:hasMemberRelation <urn:member> ."
    )
    made = http.put("/data/box/", content=body, headers={**TURTLE, "Link": direct})
    assert made.status_code == 201, made.text
    assert update(http, "INSERT DATA { GRAPH </data/box/one> { <urn:a> <urn:b> 1 } }").status_code == 204
    one = f"{http.base_url}data/box/one"
    assert asking.objects(http.get("/data/box/"), "urn:member") == {one}
    assert seen(http, "/data/box/", "<urn:member>") == [one]
    assert update(http, "DROP GRAPH </data/box/one>").status_code == 204
    assert seen(http, "/data/box/", "<urn:member>") == []


def test_a_parameter_tree_is_no_graph_of_values_and_wipes_out_nothing(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/tree/a", 1)
    robot.parameter("/tree/b", 2)
    http = serving()
    text = "INSERT DATA { GRAPH </parameters/tree> { </parameters/tree> ros:value 5 } }"
    tree = until(lambda: (found := update(http, text)).status_code != 503 and found, "the dataset")
    assert tree.status_code in (403, 409), tree.text
    below = update(http, "INSERT DATA { GRAPH </parameters/tree/a/b> { </parameters/tree/a/b> ros:value 5 } }")
    assert "/tree/a is a parameter with a value" in detail(below, 409)
    assert value(http, "/parameters/tree/") == {"a": 1, "b": 2}
    both = update(http, f"{to('/parameters/tree/a', 3, 'ros:value')} ; {to('/parameters/tree/b', 4, 'ros:value')}")
    assert both.status_code == 204, both.text
    assert value(http, "/parameters/tree/") == {"a": 3, "b": 4}


def test_a_dry_run_plans_all_of_it_and_moves_nothing(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    answer = update(http, ALL, **{"dry-run": "true"})
    assert answer.status_code == 200
    assert json.loads(answer.text)["dryRun"] is True
    told = {step["url"].removeprefix(str(http.base_url)) for step in answer.json()["steps"]}
    assert {"data/note", *(path[1:] for path in GRIPS)} <= told
    assert not [name for name in arm.calls if "/set_" in name]
    assert http.get("/data/note").status_code == 404
