"""The resources of a robot over HTTP by convention: what its names come to, and what may be done with them."""

from __future__ import annotations

import json
import threading
from typing import Any

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Refused
from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving

value, triples, objects, detail = asking.value, asking.triples, asking.objects, asking.detail
TYPES, ROS, RDF, LDP, XSD = asking.TYPES, asking.ROS, asking.RDF, asking.LDP, asking.XSD
JSON, TURTLE, JSON_LD, MERGE, UPDATE = asking.JSON, asking.TURTLE, asking.JSON_LD, asking.MERGE, asking.UPDATE
FORMATS = ("ttl", "jsonld", "nt", "rdf", "n3", "nq", "trig", "json", "html")


def ways(robot: MadeUp) -> int:
    """All calls so far."""
    return int(sum(robot.calls.values()))


# What the names of a robot come to


@pytest.mark.parametrize(
    ("kind", "values", "plain", "other", "datatype"),
    [
        ("Byte", {"value": 5}, 5, -128, f"{XSD}byte"),
        ("Words", {"words": "hi"}, "hi", 'a "quoted" <b>\n', f"{XSD}string"),
        ("Range", {"low": 0.5, "high": 2}, {"low": 0.5, "high": 2.0}, {"low": -1.5, "high": 1e30}, None),
        ("Corners", {"corners": [1, 2, 3, 4]}, {"corners": [1, 2, 3, 4]}, {"corners": [4, 3, 2, -1]}, None),
    ],
)
def test_a_getter_and_a_setter_are_one_property(
    robot: MadeUp, serving: Serving, kind: str, values: dict[str, Any], plain: Any, other: Any, datatype: str | None
) -> None:
    robot.variable("/arm/thing", kind, **values)
    http = serving()
    url = str(http.base_url.join("/resources/arm/thing"))
    assert value(http, url) == plain
    assert value(http, "/resources/arm/") == {"thing": plain}
    assert http.put(url, json=other).status_code == 204
    assert value(http, url) == other
    said = triples(http.get(url))
    (term,) = [one.object for one in said if one.predicate.value == f"{RDF}value"]
    if datatype is None:
        assert term == NamedNode(f"{url}#value")
        assert Triple(term, NamedNode(f"{RDF}type"), NamedNode(f"{TYPES}made_up/srv/Get{kind}_Response")) in said
    else:
        assert term == Literal(str(other), datatype=NamedNode(datatype))
    here = http.base_url
    assert objects(http.get(url), f"{ROS}readsFrom") == {f"{here}services/arm/get_thing"}
    assert objects(http.get(url), f"{ROS}writesTo") == {f"{here}services/arm/set_thing"}


@pytest.mark.parametrize(("get", "set"), [("getGrip", "setGrip"), ("grip/get", "grip/set")])
def test_other_habits_of_naming_are_known(robot: MadeUp, serving: Serving, get: str, set: str) -> None:
    robot.variable("/arm/grip", "Byte", get=get, set=set, value=1)
    http = serving()
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert value(http, "/resources/arm/") == {"grip": 2}
    assert http.get(f"/resources/arm/{get}").status_code == 404


def test_a_habit_of_ones_own_is_a_setting(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", get="read_{}", set="{}_write", value=1)
    robot.answer("/arm/get_secret", "made_up/srv/GetWords", words="x")
    http = serving(getter=("read_{name}",), setter=("{name}_write",), exclude_service=("*/get_secret",))
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert value(http, "/resources/arm/") == {"grip": 2}
    assert http.get("/resources/arm/secret").status_code == 404
    assert http.get("/resources/arm/get_secret").status_code == 404
    assert http.get("/services/arm/get_secret").status_code == 200


def test_what_only_sounds_like_a_getter_is_an_action(robot: MadeUp, serving: Serving) -> None:
    robot.answer("/arm/get_ready", "std_srvs/srv/Trigger", success=True, message="ready")
    robot.answer("/arm/get_map", "nav_msgs/srv/GetMap")
    robot.answer("/arm/set_aim", "made_up/srv/Aim", hit=True)
    robot.answer("/arm/get_blob", "made_up/srv/GetBlob")
    robot.topic("/arm/aim", "std_msgs/msg/String", {"data": "north"})
    http = serving()
    assert value(http, "/resources/arm/") == {"aim": "north"}
    here = f"{http.base_url}resources/arm/"
    names = {"get_ready", "get_map", "set_aim", "get_blob"}
    assert objects(http.get(here), f"{LDP}contains") == {f"{here}{name}" for name in (*names, "aim")}
    for name in names:
        answer = http.get(f"{here}{name}")
        assert objects(answer, f"{ROS}invokes") == {f"{http.base_url}services/arm/{name}"}
        assert "POST" in answer.headers["allow"]
        assert "PUT" not in answer.headers["allow"]
    assert ways(robot) == 0


def test_an_action_answers_with_what_became_of_its_namespace(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/grip", "Byte", value=1)
    robot.offer("/arm/aim", "made_up/srv/Aim", lambda one: values.update(value=int(one["azimuth"])) or {"hit": True})
    http = serving()
    assert value(http, "/resources/arm/grip") == 1
    answer = http.post("/resources/arm/aim", json={"azimuth": 7, "elevation": 0}, headers=JSON)
    assert (answer.status_code, answer.json()) == (200, {"grip": 7})
    assert answer.headers["content-location"] == f"{http.base_url}resources/arm/"
    (call,) = [one for one in answer.headers.get_list("link") if "/calls/" in one]
    assert http.get(call[1 : call.index(">")]).status_code == 200
    assert "elevation" in http.post("/resources/arm/aim?strict=true", json={"azimuth": 7}).text
    assert http.post("/resources/arm/aim", json={"azimuth": "x", "elevation": 0}).status_code == 422
    assert (
        http.post("/resources/arm/aim", content=b"{", headers={"Content-Type": "application/json"}).status_code == 400
    )
    assert robot.calls["/arm/aim"] == 1


def test_an_action_is_invoked_with_a_request_in_rdf(robot: MadeUp, serving: Serving) -> None:
    asked_with: list[dict[str, Any]] = []
    robot.offer("/arm/aim", "made_up/srv/Aim", lambda one: asked_with.append(one) or {"hit": True})
    http = serving()
    cls = f"{TYPES}made_up/srv/Aim_Request"
    for count, node in enumerate(("<#request>", "[]"), 1):
        body = f"{node} a <{cls}> ; <{cls}#azimuth> {count} ; <{cls}#elevation> 2.5 ."
        answer = http.post("/resources/arm/aim", content=body, headers=TURTLE)
        assert answer.status_code == 200, answer.text
        assert asked_with[-1] == {"azimuth": count, "elevation": 2.5}
    body = f"<#request> a <{cls}> ; <{cls}#azimuth> 1 ."
    assert "elevation" in http.post("/resources/arm/aim", content=body, headers=TURTLE).text
    assert robot.calls["/arm/aim"] == 2


def test_an_idempotency_key_invokes_an_action_once(robot: MadeUp, serving: Serving) -> None:
    robot.answer("/arm/aim", "made_up/srv/Aim", hit=True)
    http = serving()
    sent = {"headers": {"Idempotency-Key": "k1", **JSON}, "json": {"azimuth": 7, "elevation": 0}}
    first, again = http.post("/resources/arm/aim", **sent), http.post("/resources/arm/aim", **sent)
    assert (first.status_code, again.status_code, robot.calls["/arm/aim"]) == (200, 200, 1)
    sent["json"] = {"azimuth": 8, "elevation": 0}
    assert http.post("/resources/arm/aim", **sent).status_code == 422


def test_an_action_that_is_refused_says_so_in_the_robots_words(robot: MadeUp, serving: Serving) -> None:
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=False, message="the arm is folded")

    def jam(_: object) -> dict[str, Any]:
        raise Refused("it said no", words="the gripper is jammed")

    robot.offer("/arm/jam", "std_srvs/srv/Trigger", jam)
    http = serving()
    folded = http.post("/resources/arm/home")
    assert (detail(folded, 422), folded.json()["robotSaid"]) == ("/arm/home refused", "the arm is folded")
    answer = http.post("/resources/arm/jam")
    assert (detail(answer, 422), answer.json()["robotSaid"]) == ("it said no", "the gripper is jammed")
    assert http.get(answer.json()["call"]).status_code == 200


def test_topics_and_parameters_are_properties_by_themselves(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/level", "std_msgs/msg/Float64", {"data": 0.25})
    robot.topic("/arm/silent", "std_msgs/msg/Float64")
    robot.topic("/arm/command", "geometry_msgs/msg/Twist", published=False, heard=True)
    robot.parameter("/arm/name", "Bob")
    robot.parameter("/arm/joints", [1, 2.5, "x"])
    robot.parameter("/arm/pid", {"p": 1, "i": 0.5})
    http = serving(first_value_wait=0.05)
    assert value(http, "/resources/arm/") == {
        "command": None, "joints": [1, 2.5, "x"], "level": 0.25, "name": "Bob", "silent": None
    }  # fmt: skip
    assert value(http, "/resources/arm/pid/") == {"i": 0.5, "p": 1}
    assert objects(http.get("/resources/arm/"), f"{ROS}unreadable", f"{http.base_url}resources/arm/silent") == set()
    assert objects(http.get("/resources/arm/joints"), f"{RDF}value") == {'[1,2.5,"x"]'}
    twist = {"linear": {"x": 1, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0.5}}
    assert http.put("/resources/arm/command", json=twist).status_code == 204
    assert robot.sent["/arm/command"] == [twist]
    assert value(http, "/resources/arm/command") == twist
    assert http.put("/resources/arm/name", json="Eve").status_code == 204
    assert value(http, "/parameters/arm/name") == value(http, "/resources/arm/name") == "Eve"
    answer = http.put("/resources/arm/level", json=1.0)
    assert "/arm/level is published by /robot" in detail(answer, 405)
    assert answer.headers["allow"] == "GET, HEAD, OPTIONS"


def test_a_write_to_a_topic_that_nobody_hears_is_202(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/command", "std_msgs/msg/Float64", {"data": 1})
    http = serving(allow_publish=("/arm/*",))
    answer = http.put("/resources/arm/command", json=2)
    assert "no subscriber of /arm/command" in detail(answer, 202)
    assert robot.sent["/arm/command"] == [{"data": 2.0}]


def test_a_topic_is_read_before_the_getter_and_the_setter_writes_before_parameter_and_topic(
    robot: MadeUp, serving: Serving
) -> None:
    values = robot.variable("/arm/speed", "Words", words="getter")
    robot.topic("/arm/speed", "std_msgs/msg/String", {"data": "topic"}, published=False, heard=True)
    robot.publishes("/arm/speed", {"data": "topic"})
    robot.parameter("/arm/speed", "parameter")
    http = serving()
    here = str(http.base_url)
    assert value(http, "/resources/arm/speed") == "topic"
    assert http.put("/resources/arm/speed", json="one").status_code == 204
    assert (values["words"], robot.sent) == ("one", {})
    answer = http.get("/resources/arm/speed")
    assert objects(answer, f"{ROS}writesTo") == {
        f"{here}services/arm/set_speed", f"{here}parameters/arm/speed", f"{here}topics/arm/speed"
    }  # fmt: skip
    robot.withdraw("/arm/set_speed")
    assert http.put("/resources/arm/speed", json="two").status_code == 204
    assert (value(http, "/parameters/arm/speed"), values["words"], robot.sent) == ("two", "one", {})
    assert http.delete("/parameters/arm/speed").status_code == 204
    assert http.put("/resources/arm/speed", json="three").status_code == 204
    assert robot.sent["/arm/speed"] == [{"data": "three"}]
    assert robot.calls["/arm/get_speed"] == 0


def test_a_switch_of_std_srvs_writes_the_topic_of_its_name(robot: MadeUp, serving: Serving) -> None:
    def switch(request: dict[str, Any]) -> dict[str, Any]:
        robot.publishes("/arm/enabled", {"data": request["data"]})
        return {"success": True}

    robot.topic("/arm/enabled", "std_msgs/msg/Bool", {"data": False})
    robot.offer("/arm/set_enabled", "std_srvs/srv/SetBool", switch)
    http = serving()
    assert value(http, "/resources/arm/") == {"enabled": False}
    assert http.put("/resources/arm/enabled", json=True).status_code == 204
    assert value(http, "/resources/arm/enabled") is True
    assert http.put("/resources/arm/enabled", json="yes").status_code == 422
    assert http.get("/resources/arm/set_enabled").status_code == 404


def test_a_name_may_be_a_property_an_action_and_a_namespace(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm", "std_msgs/msg/String", {"data": "x"})
    robot.answer("/arm", "std_srvs/srv/Trigger", success=True)
    robot.parameter("/arm/name", "Bob")
    http = serving()
    assert value(http, "/resources/arm") == "x"
    assert value(http, "/resources/arm/") == {"name": "Bob"}
    assert value(http, "/resources/") == {"arm": "x"}
    assert http.get("/resources/arm").headers["allow"] == "GET, HEAD, OPTIONS, POST"
    answer = http.post("/resources/arm", headers=JSON)
    assert (answer.status_code, answer.json()) == (200, {"arm": "x"})
    assert answer.headers["content-location"] == f"{http.base_url}resources/"


# Bodies


def test_rdf_states_a_scalar_with_any_number_that_fits(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    url = f"{http.base_url}resources/arm/grip"

    def put(term: str) -> httpx.Response:
        body = f"@prefix xsd: <{XSD}> . @prefix rdf: <{RDF}> . <> rdf:value {term} ."
        return http.put(url, content=body, headers=TURTLE)

    for count, term in enumerate(
        ("2", '"3"^^xsd:byte', '"4"^^xsd:unsignedLong', "5.0", "6.00", '"+7"^^xsd:integer'), 2
    ):
        assert put(term).status_code == 204, term
        assert values["value"] == count
    calls = robot.calls["/arm/set_grip"]
    for term in ("128", "1.5", "6.0e0", '"2"', "true", '"x"^^xsd:byte', "<http://example.org/>", "1 , 2"):
        assert put(term).status_code == 422, term
    body = http.put(url, content="<> <http://example.org/other> 1 .", headers=TURTLE)
    assert "rdf-syntax-ns#value" in detail(body, 422) + body.text
    assert robot.calls["/arm/set_grip"] == calls
    ld = {"@id": "", f"{RDF}value": {"@value": "8", "@type": f"{XSD}byte"}}
    assert http.put(url, content=json.dumps(ld), headers=JSON_LD).status_code == 204
    assert values["value"] == 8


@pytest.mark.parametrize("media_type", ["text/turtle", "application/ld+json", "application/n-triples"])
def test_what_was_read_can_be_put_back(robot: MadeUp, serving: Serving, media_type: str) -> None:
    robot.variable("/arm/pose", "Pose", pose={"position": {"x": 1.5}, "orientation": {"w": 1}})
    robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    for name in ("pose", "grip"):
        read = http.get(f"/resources/arm/{name}", headers={"Accept": media_type})
        answer = http.put(f"/resources/arm/{name}", content=read.content, headers={"Content-Type": media_type})
        assert answer.status_code == 204, answer.text
        assert robot.calls[f"/arm/set_{name}"] == 1
    assert value(http, "/resources/arm/pose")["pose"]["position"] == {"x": 1.5, "y": 0.0, "z": 0.0}


def test_a_node_of_the_getters_or_the_setters_type_is_a_value(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/span", "Range", low=0, high=1)
    http = serving()
    for number, kind in enumerate(("GetRange_Response", "SetRange_Request"), 2):
        cls = f"{TYPES}made_up/srv/{kind}"
        body = f"<> <{RDF}value> <#v> . <#v> a <{cls}> ; <{cls}#low> {number}.0e0 ; <{cls}#high> 9.0e0 ."
        answer = http.put("/resources/arm/span", content=body, headers=TURTLE)
        assert answer.status_code == 204, answer.text
        assert values == {"low": number, "high": 9}
    cls = f"{TYPES}geometry_msgs/msg/Point"
    body = f"<> <{RDF}value> [ a <{cls}> ; <{cls}#x> 1.0e0 ] ."
    assert "GetRange_Response" in http.put("/resources/arm/span", content=body, headers=TURTLE).text
    assert robot.calls["/arm/set_span"] == 2


def test_a_property_is_patched_in_json_and_in_sparql(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/span", "Range", low=0, high=1)
    number = robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    assert http.patch("/resources/arm/span", json={"high": 2}, headers=MERGE).status_code == 204
    assert values == {"low": 0, "high": 2}
    cls = f"{TYPES}made_up/srv/GetRange_Response"
    update = f"DELETE {{ ?v <{cls}#low> ?old }} INSERT {{ ?v <{cls}#low> 0.5e0 }} WHERE {{ ?v <{cls}#low> ?old }}"
    answer = http.patch("/resources/arm/span", content=update, headers=UPDATE)
    assert answer.status_code == 204, answer.text
    assert values == {"low": 0.5, "high": 2}
    update = f"DELETE {{ ?p <{RDF}value> ?v }} INSERT {{ ?p <{RDF}value> 3 }} WHERE {{ ?p <{RDF}value> ?v }}"
    assert http.patch("/resources/arm/grip", content=update, headers=UPDATE).status_code == 204
    assert number == {"value": 3}
    assert http.patch("/resources/arm/grip", json=4, headers=MERGE).status_code == 204
    assert number == {"value": 4}
    for patch in ({"high": "x"}, {"none": 1}, {"high": None}):
        assert http.patch("/resources/arm/span", json=patch, headers=MERGE).status_code == 422, patch
    assert robot.calls["/arm/set_span"] == 2


def test_a_write_may_depend_on_what_was_read(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    etag = http.get("/resources/arm/grip", headers=JSON).headers["etag"]
    assert http.put("/resources/arm/grip", json=2, headers={"If-Match": etag}).status_code == 204
    assert http.put("/resources/arm/grip", json=3, headers={"If-Match": etag}).status_code == 412
    assert http.put("/resources/arm/grip", json=3, headers={"If-None-Match": "*"}).status_code == 412
    assert http.patch("/resources/arm/", json={"grip": 3}, headers={"If-Match": etag, **MERGE}).status_code == 412
    assert robot.calls["/arm/set_grip"] == 1
    whole = http.get("/resources/arm/").headers["etag"]
    assert http.patch("/resources/arm/", json={"grip": 3}, headers={"If-Match": whole, **MERGE}).status_code == 204
    shown = http.put("/resources/arm/grip", json=4, headers={"Prefer": "return=representation", **JSON})
    assert (shown.status_code, shown.json()) == (200, 4)


def test_bodies_that_cannot_be_read_are_told_apart(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/get_only", "made_up/srv/GetByte", value=1)
    http = serving(body_limit=1024)
    url = "/resources/arm/grip"
    assert http.put(url, content=b"{", headers={"Content-Type": "application/json"}).status_code == 400
    assert http.put(url, content=b"<> a", headers=TURTLE).status_code == 400
    unknown = http.put(url, content=b"1", headers={"Content-Type": "text/plain"})
    assert unknown.status_code == 415
    assert "application/json" in unknown.headers["accept-put"]
    assert http.put(url, content=b"1", headers={"Content-Type": ""}).status_code == 415
    assert http.put(url, content=b"").status_code in (400, 415)
    assert http.put(url, json="x" * 2000).status_code == 413
    for wrong in (128, 1.5, "5", None, [], {"value": 1, "more": 2}):
        refused = http.put(url, content=json.dumps(wrong), headers={"Content-Type": "application/json"})
        assert refused.status_code == 422, wrong
        assert "constrainedBy" in refused.headers["link"]
    assert f"{url}?shape" in refused.headers["link"]
    assert http.get(url, headers={"Accept": "image/png"}).status_code == 406
    assert http.get(url, params={"format": "exe"}).status_code == 406
    only = http.put("/resources/arm/only", json=1)
    assert "has no setter" in detail(only, 405)
    assert only.headers["allow"] == "GET, HEAD, OPTIONS"
    assert http.delete(url).status_code == 405
    assert http.post(url, json=1).status_code == 405
    assert http.put("/resources/arm/", json={"grip": 1}).status_code == 405
    assert http.put("/resources/arm/none", json=1).status_code == 404
    moved = http.put("/resources/arm", json=1)
    assert (moved.status_code, moved.headers["location"]) == (308, f"{http.base_url}resources/arm/")
    assert robot.calls["/arm/set_grip"] == 0


def test_a_setter_that_refuses_is_422_in_its_words(robot: MadeUp, serving: Serving) -> None:
    robot.answer("/arm/set_grip", "made_up/srv/SetByte", success=False, message="too tight")
    robot.parameter("/arm/name", "Bob")
    http = serving()
    answer = http.put("/resources/arm/grip", json=1)
    assert "too tight" not in detail(answer, 422)
    assert answer.json()["robotSaid"] == "too tight"
    assert "/arm/name" in detail(http.put("/resources/arm/name", json="refused"), 422)


# How long a value is good


def test_freshness_is_told_and_kept(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.parameter("/arm/name", "Bob")
    robot.topic("/leg/level", "std_msgs/msg/Float64", {"data": 1})
    http = serving(freshness=60)
    for path in ("/resources/arm/grip", "/resources/arm/name", "/resources/arm/"):
        answer = http.get(path)
        assert (answer.headers["cache-control"], answer.headers["age"]) == ("max-age=60", "0")
        http.get(path, headers=JSON)
    assert http.get("/resources/leg/level").headers["cache-control"] == "no-cache"
    assert (robot.calls["/arm/get_grip"], robot.reads["/arm/name"]) == (1, 1)


def test_with_no_freshness_every_read_asks(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    http = serving(freshness=0)
    for count in (1, 2, 3):
        assert http.get("/resources/arm/grip").headers["cache-control"] == "no-cache"
        assert robot.calls["/arm/get_grip"] == count


@pytest.mark.parametrize("way", ["service", "topic", "parameter", "sibling", "action"])
def test_a_write_by_any_way_ends_the_freshness_of_its_namespace(robot: MadeUp, serving: Serving, way: str) -> None:
    values = robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/other", "Byte", value=1)
    robot.topic("/arm/command", "std_msgs/msg/Float64", published=False, heard=True)
    robot.parameter("/arm/name", "Bob")
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    robot.variable("/leg/grip", "Byte", value=1)
    http = serving(freshness=60, first_value_wait=0)
    assert (value(http, "/resources/arm/grip"), value(http, "/resources/leg/grip")) == (1, 1)
    values["value"] = 2
    assert value(http, "/resources/arm/grip") == 1
    {
        "service": lambda: http.post("/services/arm/home"),
        "topic": lambda: http.put("/topics/arm/command", json={"data": 1}),
        "parameter": lambda: http.put("/parameters/arm/name", json="Eve"),
        "sibling": lambda: http.put("/resources/arm/other", json=3),
        "action": lambda: http.post("/resources/arm/home"),
    }[way]().raise_for_status()
    assert value(http, "/resources/arm/grip") == 2
    assert value(http, "/resources/leg/grip") == 1
    assert (robot.calls["/arm/get_grip"], robot.calls["/leg/get_grip"]) == (2, 1)


def test_a_topics_value_is_as_new_as_its_message(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/level", "std_msgs/msg/Float64", {"data": 1})
    http = serving(freshness=60)
    seen = [value(http, "/resources/arm/level")]
    etag = http.get("/resources/arm/level", headers=JSON).headers["etag"]
    for number in (2, 3):
        robot.publishes("/arm/level", {"data": number})
        seen.append(value(http, "/resources/arm/level"))
    assert seen == [1, 2, 3]
    assert http.get("/resources/arm/level", headers={"If-None-Match": etag, **JSON}).status_code == 200


def test_who_waits_for_a_change_is_told_of_it(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/level", "std_msgs/msg/Float64", {"data": 1})
    http = serving()
    etag = http.get("/resources/arm/level", headers=JSON).headers["etag"]
    timer = threading.Timer(0.2, robot.publishes, ("/arm/level", {"data": 2}))
    timer.start()
    answer = http.get("/resources/arm/level", params={"after": etag, "timeout": "10"}, headers=JSON)
    timer.join()
    assert (answer.status_code, answer.json()) == (200, 2)


# Who may write


def test_a_server_that_only_reads_offers_no_write(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving(read_only=True)
    for method, path in (("PUT", "arm/grip"), ("PATCH", "arm/grip"), ("PATCH", "arm/"), ("POST", "arm/home")):
        answer = http.request(method, f"/resources/{path}", json={})
        assert "read-only" in detail(answer, 405)
        assert answer.headers["allow"] == "GET, HEAD, OPTIONS"
    said = http.get("/resources/arm/").text
    assert "writeProperty" not in said
    assert "invokeAction" not in said
    assert robot.calls.keys() == {"/arm/get_grip"}


def test_names_may_be_written_under_resources_only(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.parameter("/arm/name", "Bob")
    robot.topic("/arm/command", "std_msgs/msg/Float64", published=False, heard=True)
    robot.answer("/leg/home", "std_srvs/srv/Trigger", success=True)
    http = serving(resources_only=("/arm/*",), first_value_wait=0)
    for method, path, body in (
        ("POST", "services/arm/set_grip", {"value": 2}),
        ("PUT", "parameters/arm/name", "Eve"),
        ("PUT", "topics/arm/command", {"data": 1}),
    ):
        assert "/resources/ only" in detail(http.request(method, path, json=body), 405)
    assert robot.calls["/arm/set_grip"] == 0
    for name, body in (("grip", 2), ("name", "Eve"), ("command", 1)):
        assert http.put(f"/resources/arm/{name}", json=body).status_code == 204
    assert value(http, "/resources/arm/") == {"command": 1, "grip": 2, "name": "Eve"}
    assert http.post("/services/leg/home").status_code == 201


def test_a_walk_along_ldp_contains_calls_no_getter_that_its_page_does_not_show(robot: MadeUp, serving: Serving) -> None:
    for space in ("arm", "arm/hand", "leg"):
        robot.variable(f"/{space}/grip", "Byte", value=1)
        robot.answer(f"/{space}/home", "std_srvs/srv/Trigger", success=True)
        robot.answer(f"/{space}/get_ready", "std_srvs/srv/Trigger", success=True)
    http = serving(freshness=60)
    for path in ("/", "/resources/", "/services/", "/.well-known/wot", "/resources/arm/?format=td", "/mappings/"):
        assert http.get(path, headers={"Accept": "*/*"}).status_code == 200
    assert value(http, "/resources/") == {}
    assert ways(robot) == 0
    assert value(http, "/resources/arm/") == {"grip": 1}
    assert robot.calls == {"/arm/get_grip": 1}
    waiting, seen = [f"{http.base_url}resources/"], set()
    while waiting:
        url = waiting.pop()
        if url not in seen:
            seen.add(url)
            waiting += objects(http.get(url), f"{LDP}contains")
    assert len(seen) == 4 + 3 * 3
    assert robot.calls == {"/arm/get_grip": 1, "/arm/hand/get_grip": 1, "/leg/get_grip": 1}


def test_names_without_a_namespace_lie_in_the_root(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/grip", "Byte", value=1)
    robot.answer("/home", "std_srvs/srv/Trigger", success=True)
    robot.parameter("/arm/name", "Bob")
    http = serving(freshness=60)
    for path in ("/", "/services/", "/topics/", "/.well-known/wot", "/resources/arm/", "/resources/home"):
        assert http.get(path).status_code == 200
    assert robot.calls == {}
    here = f"{http.base_url}resources/"
    assert value(http, here) == {"grip": 1}
    assert objects(http.get(here), f"{LDP}contains") == {f"{here}{name}" for name in ("grip", "home", "arm/")}
    assert http.put(f"{here}grip", json=2).status_code == 204
    assert http.post(f"{here}home", headers=JSON).json() == {"grip": 2}
    assert http.patch(here, json={"grip": 3}, headers=MERGE).status_code == 204
    assert value(http, f"{here}grip") == 3


def test_safe_methods_never_move_the_robot(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving()
    for method in ("GET", "HEAD", "OPTIONS"):
        for path in ("arm/", "arm/grip", "arm/home", "arm/set_grip", "arm/get_grip"):
            for accept in ("text/html", "text/turtle", "application/json", "application/td+json"):
                http.request(method, f"/resources/{path}", headers={"Accept": accept})
    assert robot.calls.keys() <= {"/arm/get_grip"}


# Names as they are


HOSTILE = (
    "/we ird/a b",
    "/quo\"te/it's",
    "/ünï/日本/🤖",
    "/a//b",
    "/dots/.",
    "/dots/..",
    "/til/~",
    "/hash#tag/q?x=1&y=2",
    "/per%cent/%2F",
    "/<script>alert(1)</script>/{name}",
    "/ns/a\\b|c^d`e",
    "/ns/a.b",
    "/ns/new\nline",
    "/ns/get_",
    "/ns/get_get_x",
)


@pytest.mark.parametrize("name", HOSTILE)
def test_every_name_has_its_place(robot: MadeUp, serving: Serving, name: str) -> None:
    namespace = name.rpartition("/")[0]
    robot.topic(name, "std_msgs/msg/String", {"data": name}, published=False, heard=True)
    robot.publishes(name, {"data": name})
    robot.answer(f"{namespace}/do {name[-1]}", "std_srvs/srv/Trigger", success=True)
    robot.variable(f"{namespace}/x{name[-1]}", "Range", low=0, high=1)
    http = serving()
    names = {name, *(name[:at] or "/" for at in range(len(name)))}
    names |= {f"{namespace}/do {name[-1]}", f"{namespace}/x{name[-1]}"}
    waiting, seen = [f"{http.base_url}resources/"], set()
    while waiting:
        url = waiting.pop()
        if url not in seen:
            seen.add(url)
            for one in FORMATS:
                answer = http.get(url, params={"format": one})
                assert answer.status_code == 200, (url, one, answer.text)
            answer = http.get(url)
            assert objects(answer, f"{ROS}name") <= names
            assert "<script>alert" not in http.get(url, headers={"Accept": "text/html"}).text
            waiting += objects(answer, f"{LDP}contains")
    (own,) = [url for url in seen if value(http, url) == name]
    assert http.put(own, json="other").status_code == 204
    assert robot.sent[name] == [{"data": "other"}]
    (span,) = [url for url in seen if isinstance(value(http, url), dict) and "low" in value(http, url)]
    home = span.rpartition("/")[0] + "/"
    assert value(http, home) == {name.rpartition("/")[2]: "other", f"x{name[-1]}": {"low": 0.0, "high": 1.0}}
    patch = {name.rpartition("/")[2]: "third"}
    assert http.patch(home, json=patch, headers=MERGE).status_code == 204
    assert value(http, own) == "third"
    (act,) = [url for url in seen if "POST" in http.get(url).headers["allow"]]
    assert http.post(act, headers=JSON).headers["content-location"] == home
    thing = http.get(home, params={"format": "td"}).json()
    assert thing["properties"].keys() == {name.rpartition("/")[2], f"x{name[-1]}"}


def test_an_address_that_no_name_has_is_refused(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/arm/name", "Bob")
    http = serving()
    for path in ("arm//name", "arm/%FF", "arm/%2Fname", "arm/%zz"):
        assert http.get(f"/resources/{path}").status_code == 400, path
    for path in ("none", "none/", "arm/none", "arm/name/none", "arm/name/none/", "~", "arm/~"):
        for method in ("GET", "HEAD", "PUT", "POST", "PATCH", "DELETE"):
            assert http.request(method, f"/resources/{path}", json=1).status_code in (404, 405), path


# HTTP as it should be


def test_a_slash_too_many_or_too_few_is_put_right(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/arm/name", "Bob")
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving()
    here = f"{http.base_url}resources"
    for wrong, right in (("", "/"), ("/arm", "/arm/"), ("/arm/name/", "/arm/name"), ("/arm/home/", "/arm/home")):
        for method in ("GET", "HEAD", "OPTIONS", "PUT", "POST"):
            answer = http.request(method, here + wrong)
            assert (answer.status_code, answer.headers["location"]) == (308, here + right), (method, wrong)


@pytest.mark.parametrize("path", ["arm/", "arm/grip", "arm/home"])
def test_head_is_get_without_the_body(robot: MadeUp, serving: Serving, path: str) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving(freshness=60)
    for accept in ("text/turtle", "application/json", "application/td+json", "text/html"):
        get, head = (http.request(one, f"/resources/{path}", headers={"Accept": accept}) for one in ("GET", "HEAD"))
        assert head.content == b""
        left_out = ("date", "age")
        assert {k: v for k, v in head.headers.items() if k not in left_out} == {
            k: v for k, v in get.headers.items() if k not in left_out
        }
        assert "accept" in get.headers["vary"].lower()


def test_options_tells_what_can_be_done(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving()
    for path, dispatcher in (
        ("", {"GET", "HEAD", "OPTIONS"}),
        ("arm/", {"GET", "HEAD", "OPTIONS", "PATCH"}),
        ("arm/grip", {"GET", "HEAD", "OPTIONS", "PATCH", "PUT"}),
        ("arm/home", {"GET", "HEAD", "OPTIONS", "POST"}),
    ):
        answer = http.options(f"/resources/{path}")
        assert (answer.status_code, set(answer.headers["allow"].split(", "))) == (204, dispatcher)
        assert ("accept-patch" in answer.headers) == ("PATCH" in dispatcher)
        assert ("accept-put" in answer.headers) == ("PUT" in dispatcher)
        assert ("accept-post" in answer.headers) == ("POST" in dispatcher)
        assert f'<{LDP}Resource>; rel="type"' in answer.headers["link"]
        assert (f"{LDP}BasicContainer" in answer.headers["link"]) == (path.endswith("/") or not path)
    assert robot.calls == {}


@pytest.mark.parametrize("path", ["", "arm/", "arm/grip", "arm/home", "arm/level"])
@pytest.mark.parametrize("accept", ["text/turtle", "application/json", "application/td+json", "text/html"])
def test_what_has_not_changed_is_not_sent_again(robot: MadeUp, serving: Serving, path: str, accept: str) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.topic("/arm/level", "std_msgs/msg/Float64", {"data": 1})
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving(freshness=60 if accept == "text/html" else 0)  # a page tells when it was read
    if accept == "application/td+json" and not path.endswith("/") and path:
        assert http.get(f"/resources/{path}", headers={"Accept": accept}).status_code == 406
        return
    first = http.get(f"/resources/{path}", headers={"Accept": accept})
    assert first.headers["content-type"].partition(";")[0] == accept
    for tag in (first.headers["etag"], f"W/{first.headers['etag']}", f'"x", {first.headers["etag"]}', "*"):
        again = http.get(f"/resources/{path}", headers={"Accept": accept, "If-None-Match": tag})
        assert (again.status_code, again.content) == (304, b""), tag
        assert again.headers["etag"] == first.headers["etag"]
        assert "accept" in again.headers["vary"].lower()
        assert again.headers["cache-control"] == first.headers["cache-control"]
    assert http.get(f"/resources/{path}", headers={"Accept": accept, "If-None-Match": '"x"'}).status_code == 200


def test_a_representation_is_chosen_by_accept_or_by_format(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/span", "Range", low=0, high=1)
    http = serving(freshness=60)
    for path in ("/resources/arm/", "/resources/arm/span", "/resources/"):
        same = [triples(http.get(path, params={"format": one})) for one in ("ttl", "jsonld", "nt", "rdf", "n3", "nq")]
        assert all(one == same[0] for one in same)
        plain = http.get(path, params={"format": "json"}, headers={"Accept": "text/html"})
        assert plain.headers["content-type"] == "application/json"
        assert (
            http.get(path, headers={"Accept": "application/json;q=0.5, text/turtle"})
            .headers["content-type"]
            .startswith("text/turtle")
        )
    tags = {one: http.get("/resources/arm/", params={"format": one}).headers["etag"] for one in (*FORMATS, "td")}
    assert len(set(tags.values())) == len(tags)
    for accept in ("application/td+json", "application/td+json, application/json;q=0.9"):
        thing = http.get("/resources/arm/", headers={"Accept": accept})
        assert thing.headers["content-type"] == "application/td+json"
        assert thing.json()["properties"].keys() == {"span"}
    browser = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"
    assert "text/html" in http.get("/resources/arm/", headers={"Accept": browser}).headers["content-type"]


# SPARQL


def asked(http: httpx.Client, query: str) -> list[dict[str, str]]:
    """The rows of a query."""
    answer = http.post(
        "/sparql",
        content=query,
        headers={"Content-Type": "application/sparql-query", "Accept": "application/sparql-results+json"},
    )
    assert answer.status_code == 200, answer.text
    return [{k: v["value"] for k, v in row.items()} for row in answer.json()["results"]["bindings"]]


def test_a_query_sees_the_resources_that_it_names_and_asks_no_other(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=3)
    robot.variable("/arm/span", "Range", low=0.5, high=1)
    robot.variable("/leg/grip", "Byte", value=4)
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    http = serving(freshness=60)
    here = f"{http.base_url}resources/"
    assert asked(http, "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }")
    assert asked(http, "SELECT ?g (COUNT(*) AS ?n) { GRAPH ?g { ?s ?p ?o } } GROUP BY ?g")
    assert asked(http, f"SELECT ?v {{ ?s <{ROS}value> ?v }}") == []
    assert robot.calls == {}
    found = asked(
        http,
        f"SELECT ?m ?v {{ GRAPH <{here}arm/> {{ ?arm <{LDP}contains> ?m OPTIONAL {{ ?m <{RDF}value> ?v }} }} }}",
    )
    assert sorted((one["m"].removeprefix(here), one.get("v")) for one in found) == [
        ("arm/grip", "3"), ("arm/home", None), ("arm/span", f"{here}arm/#span")
    ]  # fmt: skip
    assert robot.calls == {"/arm/get_grip": 1, "/arm/get_span": 1}
    assert asked(http, f"SELECT ?v {{ GRAPH <{here}arm/grip> {{ ?s <{RDF}value> ?v }} }}") == [{"v": "3"}]
    assert http.put("/resources/arm/grip", json=9).status_code == 204
    assert asked(http, f"SELECT ?v {{ GRAPH <{here}arm/grip> {{ ?s <{RDF}value> ?v }} }}") == [{"v": "9"}]
    assert robot.calls["/leg/get_grip"] == 0
    assert asked(http, f"SELECT ?v {{ GRAPH <{here}none/> {{ ?s ?p ?v }} }}") == []
    low = f"<{TYPES}made_up/srv/GetRange_Response#low>"
    assert asked(http, f"SELECT ?v FROM NAMED <{here}arm/span> {{ GRAPH ?g {{ ?s {low} ?v }} }}") == [{"v": "0.5"}]


def test_a_query_waits_no_longer_than_it_may_for_a_getter_that_hangs(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=3)
    robot.variable("/arm/span", "Range", low=0.5, high=1)
    robot.hold("/arm/get_grip")
    http = serving(read_deadline=0.3)
    here = f"{http.base_url}resources/"
    (why,) = asked(http, f"SELECT ?why {{ GRAPH <{here}arm/> {{ <{here}arm/grip> <{ROS}unreadable> ?why }} }}")
    assert "has not answered" in why["why"]
    robot.release("/arm/get_grip")


def test_mappings_are_graphs_and_what_they_say_of_resources_is_seen(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=3)
    robot.variable("/arm/mode", "Words", words="manual")
    http = serving(freshness=60)
    asking.mapped(
        http,
        """<#arm> a map:ComplexResource ; map:path "/arm/" ;
             map:property [ map:predicate ex:grip ; map:member "grip" ] ;
             map:property [ map:predicate ex:mode ; map:member "mode" ] ;
             map:link [ map:relation ex:up ; map:target "/" ; map:availableWhen <#manual> ] .
           <#manual> a sh:NodeShape ; map:about "/arm/" ; sh:property [ sh:path ex:mode ; sh:hasValue "manual" ] .""",
    )
    url, ex = f"{http.base_url}resources/arm/", asking.EX
    path = "https://w3id.org/rosld/mapping#path"
    assert asked(http, f"SELECT ?p {{ GRAPH <{http.base_url}mappings/mine> {{ ?c <{path}> ?p }} }}") == [{"p": "/arm/"}]
    query = f"SELECT ?g ?up {{ GRAPH <{url}> {{ <{url}> <{ex}grip> ?g OPTIONAL {{ <{url}> <{ex}up> ?up }} }} }}"
    assert asked(http, query) == [{"g": "3", "up": f"{http.base_url}resources/"}]
    assert http.put("/resources/arm/mode", json="automatic").status_code == 204
    assert asked(http, query) == [{"g": "3"}]
    assert http.delete("/mappings/mine").status_code == 204
    assert asked(http, query) == []
    assert asked(http, f"SELECT ?p {{ GRAPH <{http.base_url}mappings/mine> {{ ?c <{path}> ?p }} }}") == []
