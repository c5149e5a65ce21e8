"""The resources of a robot over HTTP by convention: those that follow from its names, and their methods."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pyoxigraph import Literal, NamedNode, Triple

from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving

value, triples, objects, detail = asking.value, asking.triples, asking.objects, asking.detail
TYPES, ROS, RDF, LDP, XSD = asking.TYPES, asking.ROS, asking.RDF, asking.LDP, asking.XSD
JSON, TURTLE, JSON_LD, MERGE, UPDATE = asking.JSON, asking.TURTLE, asking.JSON_LD, asking.MERGE, asking.UPDATE
TRIGGER, STRING, FLOAT = "std_srvs/srv/Trigger", "std_msgs/msg/String", "std_msgs/msg/Float64"

# Resources that follow from names


KINDS: tuple[tuple[str, dict[str, Any], Any, Any, str | None], ...] = (
    ("Byte", {"value": 5}, 5, -128, f"{XSD}byte"),
    ("Words", {"words": "hi"}, "hi", 'a "quoted" <b>\n', f"{XSD}string"),
    ("Range", {"low": 0.5, "high": 2}, {"low": 0.5, "high": 2.0}, {"low": -1.5, "high": 1e30}, None),
    ("Corners", {"corners": [1, 2, 3, 4]}, {"corners": [1, 2, 3, 4]}, {"corners": [4, 3, 2, -1]}, None),
)
"""Kind of service, first value, its JSON, another value in JSON, and the datatype of a scalar."""


def test_a_getter_and_a_setter_are_one_property(robot: MadeUp, serving: Serving) -> None:
    for kind, values, *_ in KINDS:
        robot.variable(f"/arm/{kind}", kind, **values)
    http = serving()
    here = http.base_url
    assert value(http, "/resources/arm/") == {kind: plain for kind, _, plain, *_ in KINDS}
    for kind, _, plain, other, datatype in KINDS:
        url = str(here.join(f"/resources/arm/{kind}"))
        assert value(http, url) == plain
        assert http.put(url, json=other).status_code == 204
        assert value(http, url) == other
        answer = http.get(url)
        said = triples(answer)
        (term,) = [one.object for one in said if one.predicate.value == f"{RDF}value"]
        if datatype is None:
            assert term == NamedNode(f"{url}#value")
            assert Triple(term, NamedNode(f"{RDF}type"), NamedNode(f"{TYPES}made_up/srv/Get{kind}_Response")) in said
        else:
            assert term == Literal(str(other), datatype=NamedNode(datatype))
        assert objects(answer, f"{ROS}readsFrom") == {f"{here}services/arm/get_{kind}"}
        assert objects(answer, f"{ROS}writesTo") == {f"{here}services/arm/set_{kind}"}


def test_other_naming_conventions_are_known_and_settings_add_to_them(robot: MadeUp, serving: Serving) -> None:
    habits = {"camel": ("getGrip", "setGrip"), "slash": ("grip/get", "grip/set"), "own": ("read_grip", "grip_write")}
    for space, (get, set) in habits.items():
        robot.variable(f"/{space}/grip", "Byte", get=get, set=set, value=1)
    robot.answer("/own/get_secret", "made_up/srv/GetWords", words="x")
    http = serving(getter=("read_{name}",), setter=("{name}_write",), exclude_service=("*/get_secret",))
    for space, (get, _) in habits.items():
        assert http.put(f"/resources/{space}/grip", json=2).status_code == 204
        assert value(http, f"/resources/{space}/") == {"grip": 2}
        assert http.get(f"/resources/{space}/{get}").status_code == 404
    for name in ("secret", "get_secret"):
        assert http.get(f"/resources/own/{name}").status_code == 404
    assert http.get("/services/own/get_secret").status_code == 200


def test_an_action_answers_with_what_became_of_its_namespace(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/grip", "Byte", value=1)
    robot.offer("/arm/aim", "made_up/srv/Aim", lambda one: values.update(value=int(one["azimuth"])) or {"hit": True})
    http = serving()
    url, cls = "/resources/arm/aim", f"{TYPES}made_up/srv/Aim_Request"
    answer = http.post(url, json={"azimuth": 7, "elevation": 0}, headers=JSON)
    assert (answer.status_code, answer.json()) == (200, {"grip": 7})
    assert answer.headers["content-location"] == f"{http.base_url}resources/arm/"
    (call,) = [one for one in answer.headers.get_list("link") if "/calls/" in one]
    assert http.get(call[1 : call.index(">")]).status_code == 200
    for count, node in enumerate(("<#request>", "[]"), 1):
        body = f"{node} a <{cls}> ; <{cls}#azimuth> {count} ; <{cls}#elevation> 2.5 ."
        assert http.post(url, content=body, headers={**TURTLE, **JSON}).json() == {"grip": count}
    body = f"<#request> a <{cls}> ; <{cls}#azimuth> 1 ."
    for refused in (
        http.post(url, content=body, headers=TURTLE),
        http.post(f"{url}?strict=true", json={"azimuth": 7}),
        http.post(url, json={"azimuth": "x", "elevation": 0}),
    ):
        assert (refused.status_code, "elevation" in refused.text or "azimuth" in refused.text) == (422, True)
    assert http.post(url, content=b"{", headers={"Content-Type": "application/json"}).status_code == 400
    assert robot.calls["/arm/aim"] == 3
    sent = {"headers": {"Idempotency-Key": "k1"}, "json": {"azimuth": 9, "elevation": 0}}
    assert [http.post(url, **sent).status_code for _ in range(2)] == [200, 200]
    assert robot.calls["/arm/aim"] == 4, "the key invokes it once"
    assert http.post(url, headers=sent["headers"], json={"azimuth": 8, "elevation": 0}).status_code == 422


def test_topics_and_parameters_are_properties_by_themselves(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/arm/level", FLOAT, {"data": 0.25})
    robot.topic("/arm/silent", FLOAT)
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


def test_a_topic_is_read_before_the_getter_and_the_setter_writes_before_parameter_and_topic(
    robot: MadeUp, serving: Serving
) -> None:
    values = robot.variable("/arm/speed", "Words", words="getter")
    robot.topic("/arm/speed", STRING, {"data": "topic"}, published=False, heard=True)
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
    robot.topic("/arm", STRING, {"data": "x"})
    robot.answer("/arm", TRIGGER, success=True)
    robot.parameter("/arm/name", "Bob")
    http = serving()
    assert value(http, "/resources/arm") == "x"
    assert value(http, "/resources/arm/") == {"name": "Bob"}
    assert value(http, "/resources/") == {"arm": "x"}
    assert http.get("/resources/arm").headers["allow"] == "GET, HEAD, OPTIONS, POST"
    answer = http.post("/resources/arm", headers=JSON)
    assert (answer.status_code, answer.json()) == (200, {"arm": "x"})
    assert answer.headers["content-location"] == f"{http.base_url}resources/"


def test_what_was_read_can_be_put_back(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/pose", "Pose", pose={"position": {"x": 1.5}, "orientation": {"w": 1}})
    robot.variable("/arm/grip", "Byte", value=1)
    http = serving()
    for media_type in ("text/turtle", "application/ld+json", "application/n-triples"):
        for name in ("pose", "grip"):
            read = http.get(f"/resources/arm/{name}", headers={"Accept": media_type})
            answer = http.put(f"/resources/arm/{name}", content=read.content, headers={"Content-Type": media_type})
            assert answer.status_code == 204, answer.text
    assert robot.calls["/arm/set_pose"] == robot.calls["/arm/set_grip"] == 3
    assert value(http, "/resources/arm/pose")["pose"]["position"] == {"x": 1.5, "y": 0.0, "z": 0.0}


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


def test_each_bad_body_has_its_status(robot: MadeUp, serving: Serving) -> None:
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
    assert "has no writable setter" in detail(only, 405)
    assert only.headers["allow"] == "GET, HEAD, OPTIONS"
    assert http.delete(url).status_code == 405
    assert http.post(url, json=1).status_code == 405
    assert http.put("/resources/arm/", json={"grip": 1}).status_code == 405
    assert http.put("/resources/arm/none", json=1).status_code == 404
    moved = http.put("/resources/arm", json=1)
    assert (moved.status_code, moved.headers["location"]) == (308, f"{http.base_url}resources/arm/")
    assert robot.calls["/arm/set_grip"] == 0


def test_freshness_is_in_the_headers_and_bounds_how_often_the_robot_is_asked(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.parameter("/arm/name", "Bob")
    robot.topic("/leg/level", FLOAT, {"data": 1})
    http = serving(freshness=60)
    for path in ("/resources/arm/grip", "/resources/arm/name", "/resources/arm/"):
        answer = http.get(path)
        assert (answer.headers["cache-control"], answer.headers["age"]) == ("max-age=60", "0")
        http.get(path, headers=JSON)
    assert (robot.calls["/arm/get_grip"], robot.reads["/arm/name"]) == (1, 1)
    level = http.get("/resources/leg/level", headers=JSON)
    assert (level.headers["cache-control"], level.json()) == ("no-cache", 1)
    robot.publishes("/leg/level", {"data": 2})
    again = http.get("/resources/leg/level", headers={"If-None-Match": level.headers["etag"], **JSON})
    assert (again.status_code, again.json()) == (200, 2), "a topic's value is as new as its message"


def test_a_write_by_any_way_ends_the_freshness_of_its_namespace(robot: MadeUp, serving: Serving) -> None:
    values = robot.variable("/arm/grip", "Byte", value=0)
    robot.variable("/arm/other", "Byte", value=1)
    robot.topic("/arm/command", FLOAT, published=False, heard=True)
    robot.parameter("/arm/name", "Bob")
    robot.answer("/arm/home", TRIGGER, success=True)
    robot.variable("/leg/grip", "Byte", value=1)
    http = serving(freshness=60, first_value_wait=0)
    assert value(http, "/resources/leg/grip") == 1
    for count, (method, path, body) in enumerate(
        (
            ("POST", "/services/arm/home", {}),
            ("PUT", "/topics/arm/command", {"data": 1}),
            ("PUT", "/parameters/arm/name", "Eve"),
            ("PUT", "/resources/arm/other", 3),
            ("POST", "/resources/arm/home", {}),
        )
    ):
        assert value(http, "/resources/arm/grip") == count
        values["value"] = count + 1
        assert value(http, "/resources/arm/grip") == count, path
        http.request(method, path, json=body).raise_for_status()
        assert value(http, "/resources/arm/grip") == count + 1, path
    assert value(http, "/resources/leg/grip") == 1
    assert robot.calls["/leg/get_grip"] == 1


def test_names_may_be_written_under_resources_only(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", value=1)
    robot.parameter("/arm/name", "Bob")
    robot.topic("/arm/command", FLOAT, published=False, heard=True)
    robot.answer("/leg/home", TRIGGER, success=True)
    http = serving(resources_only=("/arm/*",), first_value_wait=0)
    for method, path, body in (
        ("POST", "services/arm/set_grip", {"value": 2}),
        ("PUT", "parameters/arm/name", "Eve"),
        ("PUT", "topics/arm/command", {"data": 1}),
    ):
        assert "only through /resources/" in detail(http.request(method, path, json=body), 405)
    assert robot.calls["/arm/set_grip"] == 0
    for name, body in (("grip", 2), ("name", "Eve"), ("command", 1)):
        assert http.put(f"/resources/arm/{name}", json=body).status_code == 204
    assert value(http, "/resources/arm/") == {"command": 1, "grip": 2, "name": "Eve"}
    assert http.post("/services/leg/home").status_code == 201


def test_a_walk_along_ldp_contains_calls_no_getter_that_its_page_does_not_show(robot: MadeUp, serving: Serving) -> None:
    for space in ("arm", "arm/hand", "leg"):
        robot.variable(f"/{space}/grip", "Byte", value=1)
        robot.answer(f"/{space}/home", TRIGGER, success=True)
        robot.answer(f"/{space}/get_ready", TRIGGER, success=True)
    http = serving(freshness=60)
    for path in ("/", "/resources/", "/services/", "/.well-known/wot", "/resources/arm/?format=td", "/mappings/"):
        assert http.get(path, headers={"Accept": "*/*"}).status_code == 200
    assert value(http, "/resources/") == {}
    assert not robot.calls
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


HOSTILE = (
    "/we ird/a b",
    "/quo\"te/it's",
    "/ünï/日本/🤖",
    "/a//b",
    "/dot/.",
    "/dots/..",
    "/til/~",
    "/hash#tag/q?x=1&y=2",
    "/per%cent/%2F",
    "/<script>alert(1)</script>/{name}",
    "/ns1/a\\b|c^d`e",
    "/ns2/a.b",
    "/ns3/new\nline",
    "/ns4/get_",
    "/ns5/get_get_x",
)


@pytest.mark.slow
def test_every_name_has_its_place(robot: MadeUp, serving: Serving) -> None:
    for name in HOSTILE:
        namespace = name.rpartition("/")[0]
        robot.topic(name, STRING, {"data": name}, published=False, heard=True)
        robot.answer(f"{namespace}/do {name[-1]}", TRIGGER, success=True)
        robot.variable(f"{namespace}/x{name[-1]}", "Range", low=0, high=1)
    http = serving(freshness=60)
    waiting, allowed, values = [f"{http.base_url}resources/"], dict[str, str](), dict[str, Any]()
    while waiting:
        url = waiting.pop()
        for one in ("jsonld", "rdf", "html"):
            answer = http.get(url, params={"format": one})
            assert answer.status_code == 200, (url, one, answer.text)
        assert "<script>alert" not in answer.text
        answer = http.get(url)
        waiting += objects(answer, f"{LDP}contains")
        allowed[url], values[url] = answer.headers["allow"], value(http, url)
    for name in HOSTILE:
        own, other = name.rpartition("/")[2], f"x{name[-1]}"
        (url,) = [url for url, plain in values.items() if plain == name]
        (home,) = [url for url, plain in values.items() if plain == {own: name, other: {"low": 0.0, "high": 1.0}}]
        assert objects(http.get(url), f"{ROS}name") == {name}
        assert http.put(url, json="other").status_code == 204
        assert robot.sent[name] == [{"data": "other"}]
        assert http.patch(home, json={own: "third"}, headers=MERGE).status_code == 204
        assert value(http, url) == "third"
        (act,) = [url for url, methods in allowed.items() if url.rpartition("/")[0] + "/" == home and "POST" in methods]
        assert http.post(act, headers=JSON).headers["content-location"] == home
        assert http.get(home, params={"format": "td"}).json()["properties"].keys() == {own, other}


def test_a_url_that_no_name_has_is_refused_or_corrected(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/arm/name", "Bob")
    http = serving()
    for path in ("arm//name", "arm/%FF", "arm/%2Fname", "arm/%zz"):
        assert http.get(f"/resources/{path}").status_code == 400, path
    for path in ("none", "none/", "arm/none", "arm/name/none", "arm/name/none/", "~", "arm/~"):
        for method in ("GET", "HEAD", "PUT", "POST", "PATCH", "DELETE"):
            assert http.request(method, f"/resources/{path}", json=1).status_code in (404, 405), path
    for wrong, right in (("", "/"), ("/arm", "/arm/"), ("/arm/name/", "/arm/name")):
        for method in ("GET", "OPTIONS", "PUT"):
            answer = http.request(method, f"/resources{wrong}")
            assert answer.status_code == 308, (method, wrong)
            assert answer.headers["location"] == f"{http.base_url}resources{right}"
