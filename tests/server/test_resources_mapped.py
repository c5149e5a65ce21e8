"""Resources arranged by mappings, over HTTP: late names, guards, other namespaces, fields, changes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving

pytestmark = pytest.mark.slow

value, objects, detail, mapped = asking.value, asking.objects, asking.detail, asking.mapped
ROS, RDF, LDP, EX, PREFIXES = asking.ROS, asking.RDF, asking.LDP, asking.EX, asking.PREFIXES
JSON, TURTLE, MERGE, UPDATE = asking.JSON, asking.TURTLE, asking.MERGE, asking.UPDATE
QUDT = "http://qudt.org/schema/qudt/"
GRIPPER = """
<#gripper> a map:ComplexResource ; map:path "/gripper/" ;
  map:property [ map:predicate ex:force ; map:member "/arm/grip" ; map:name "force" ] ,
    [ map:predicate ex:x ; map:member "/arm/pose" ; map:field "pose.position.x" ; qudt:hasUnit unit:M ;
      qudt:hasQuantityKind quantitykind:Length ] ,
    [ map:predicate ex:y ; map:member "/arm/pose" ; map:field "pose.position.y" ; qudt:hasUnit unit:M ] ;
  map:action [ map:relation ex:home ; map:name "fold" ; map:service "/arm/home" ] ;
  map:link [ map:relation ex:arm ; map:target "/arm/" ] .
"""
SAFE = """
<#arm> a map:ComplexResource ; map:path "/arm/" ;
  map:property [ map:predicate ex:mode ; map:member "mode" ] ,
    [ map:predicate ex:grip ; map:member "grip" ; map:writableWhen <#manual> ] ;
  map:action [ map:relation ex:home ; map:service "/arm/home" ; map:availableWhen <#manual> ] .
<#hand> a map:ComplexResource ; map:path "/arm/hand/" ; map:existsWhen <#manual> ;
  map:property [ map:predicate ex:width ; map:member "width" ] .
<#manual> a sh:NodeShape ; map:about "/arm/mode" ; sh:property [ sh:path rdf:value ; sh:hasValue "manual" ] .
"""


@pytest.fixture
def arm(robot: MadeUp) -> MadeUp:
    """An arm with a hand."""
    robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/mode", "Words", words="manual")
    robot.variable("/arm/pose", "Pose", pose={"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"w": 1}})
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    robot.variable("/arm/hand/width", "Byte", value=9)
    robot.variable("/arm/hand/finger/length", "Byte", value=8)
    robot.answer("/arm/hand/wave", "std_srvs/srv/Trigger", success=True)
    return robot


def mode(http: httpx.Client, word: str) -> None:
    assert http.put("/resources/arm/mode", json=word).status_code == 204


def test_a_mapping_may_name_what_comes_later(robot: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, SAFE)
    assert value(http, "/resources/") == {}
    assert value(http, "/resources/arm/") == {}
    assert http.get("/resources/arm/grip").status_code == 404
    assert http.post("/resources/arm/home").status_code == 404
    assert http.get("/resources/arm/hand/").status_code == 404
    grip = robot.variable("/arm/grip", "Byte", value=1)
    assert value(http, "/resources/arm/") == {"grip": 1}
    assert "cannot be read" in detail(http.put("/resources/arm/grip", json=2), 409)
    robot.variable("/arm/mode", "Words", words="manual")
    robot.answer("/arm/home", "std_srvs/srv/Trigger", success=True)
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert grip["value"] == 2
    assert http.post("/resources/arm/home", headers=JSON).json() == {"grip": 2, "mode": "manual"}
    assert value(http, "/resources/arm/hand/") == {}
    robot.variable("/arm/hand/width", "Byte", value=9)
    assert value(http, "/resources/arm/hand/") == {"width": 9}
    robot.withdraw("/arm/get_mode")
    robot.withdraw("/arm/set_mode")
    assert value(http, "/resources/arm/") == {"grip": 2}
    assert http.get("/resources/arm/hand/").status_code == 404


def test_readers_see_one_mapping_or_the_other_while_it_is_replaced(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    documents = [
        f"""<#a> a map:ComplexResource ; map:path "/arm/" ;
              map:property [ map:predicate ex:{name}1 ; map:member "grip" ; map:name "{name}1" ] ,
                [ map:predicate ex:{name}2 ; map:member "mode" ; map:name "{name}2" ] ."""
        for name in ("p", "q")
    ]
    mapped(http, documents[0])
    seen: list[dict[str, Any]] = []

    def read(_: int) -> None:
        while len(seen) < 100:
            seen.append(value(http, "/resources/arm/"))

    with ThreadPoolExecutor(4) as pool:
        reading = [pool.submit(read, each) for each in range(4)]
        count = 0
        while not all(one.done() for one in reading):
            count += 1
            mapped(http, documents[count % 2])
        for one in reading:
            one.result()
    assert {tuple(sorted(one)) for one in seen} == {("p1", "p2"), ("q1", "q2")}


def test_members_may_come_from_other_namespaces_and_be_fields_with_units(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    url = f"{http.base_url}resources/gripper/"
    assert value(http, url) == {"force": 1, "x": 1.0, "y": 2.0}
    whole = http.get(url)
    assert objects(whole, f"{EX}force") == {"1"}
    assert objects(whole, f"{EX}x") == {"1.0"}
    assert objects(whole, f"{EX}arm") == {f"{http.base_url}resources/arm/"}
    assert objects(whole, f"{EX}home") == {f"{url}fold"}
    assert objects(whole, f"{QUDT}hasUnit", f"{url}#properties/x") == {"http://qudt.org/vocab/unit/M"}
    assert objects(whole, f"{QUDT}hasQuantityKind", f"{url}#properties/x") == {
        "http://qudt.org/vocab/quantitykind/Length"
    }
    thing = http.get(url, headers={"Accept": "application/td+json"}).json()
    assert thing["properties"].keys() >= {"force"}
    assert "http://qudt.org/vocab/unit/M" in str(thing) or "unit:M" in str(thing)
    assert http.put("/resources/arm/grip", json=5).status_code == 204
    assert value(http, url)["force"] == 5


def test_a_service_that_a_mapping_offers_is_offered_there_only(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    fold = f"{http.base_url}resources/gripper/fold"
    for answer in (http.get("/resources/arm/home"), http.post("/resources/arm/home")):
        assert (answer.status_code, answer.headers["location"]) == (308, fold)
    assert arm.calls["/arm/home"] == 0
    assert f"{http.base_url}resources/arm/home" not in objects(http.get("/resources/arm/"), f"{LDP}contains")
    answer = http.post(fold, headers=JSON)
    assert (answer.status_code, answer.headers["content-location"]) == (200, f"{http.base_url}resources/gripper/")
    assert arm.calls["/arm/home"] == 1


def test_a_setter_that_is_an_action_writes_no_property(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    action = 'map:action [ map:relation ex:squeeze ; map:name "squeeze" ; map:service "/arm/set_grip" ]'
    mapped(http, f'<#g> a map:ComplexResource ; map:path "/gripper/" ; {action} .')
    assert http.put("/resources/arm/grip", json=5).status_code == 405
    assert http.patch("/resources/arm/", json={"grip": 5}, headers=MERGE).status_code in (405, 409)
    assert arm.calls["/arm/set_grip"] == 0
    assert http.post("/resources/gripper/squeeze", json={"value": 5}).status_code == 200
    assert value(http, "/resources/arm/grip") == 5


def test_a_guard_holds_wherever_its_member_is_written(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, SAFE)
    mapped(
        http,
        """<#g> a map:ComplexResource ; map:path "/gripper/" ;
             map:property [ map:predicate ex:force ; map:member "/arm/grip" ; map:name "force" ] .""",
        "gripper",
    )
    assert http.patch("/resources/gripper/", json={"force": 2}, headers=MERGE).status_code == 204
    mode(http, "automatic")
    assert "writeProperty" not in http.get("/resources/gripper/").text
    for answer in (
        http.patch("/resources/gripper/", json={"force": 3}, headers=MERGE),
        http.patch("/resources/arm/", json={"grip": 3}, headers=MERGE),
        http.patch("/resources/arm/grip", json=3, headers=MERGE),
        http.put("/resources/arm/grip", json=3),
        http.patch("/resources/arm/", json={"mode": "manual", "grip": 3}, headers=MERGE),
    ):
        assert "must not be written now" in detail(answer, 409)
        assert "manual" in answer.text
    assert arm.calls["/arm/set_grip"] == 1
    report = http.put("/resources/arm/grip", json=3, headers={"Accept": "text/turtle"})
    assert "ValidationReport" in report.text
    assert value(http, "/resources/arm/") == {"grip": 2, "mode": "automatic"}
    assert http.post("/services/arm/set_grip", json={"value": 4}).status_code == 201  # level one is not guarded


def test_a_condition_that_does_not_hold_hides_all_that_lies_below(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, SAFE)
    paths = [f"/resources/arm/hand/{path}" for path in ("", "width", "wave", "finger/", "finger/length")]
    assert all(http.get(path).status_code == 200 for path in paths)
    assert value(http, "/resources/arm/hand/finger/") == {"length": 8}
    mode(http, "automatic")
    for path in paths:
        assert "manual" in detail(http.get(path), 404), path
        assert http.head(path).status_code == 404
        assert "manual" in detail(http.get(path, params={"shape": ""}), 404), path
    for path in ("", "finger/"):  # clients store it, so it has all that may exist
        assert http.get(f"/resources/arm/hand/{path}?format=td").status_code == 200
    for method, path, body in (
        ("PUT", "width", 3), ("PUT", "finger/length", 3), ("POST", "wave", {}),
    ):  # fmt: skip
        assert "manual" in detail(http.request(method, f"/resources/arm/hand/{path}", json=body), 404)
    assert http.patch("/resources/arm/hand/", json={"width": 3}, headers=MERGE).status_code == 404
    assert http.patch("/resources/arm/hand/finger/", json={"length": 3}, headers=MERGE).status_code == 404
    assert f"{http.base_url}resources/arm/hand/" not in objects(http.get("/resources/arm/"), f"{LDP}contains")
    assert "hand" not in http.get("/resources/arm/").text
    assert arm.calls["/arm/hand/set_width"] == arm.calls["/arm/hand/wave"] == 0
    mode(http, "manual")
    assert all(http.get(path).status_code == 200 for path in paths)


def test_a_condition_is_judged_by_the_present_state_and_changes_the_entity_tag(arm: MadeUp, serving: Serving) -> None:
    http = serving(freshness=60)
    mapped(http, SAFE.replace('map:property [ map:predicate ex:mode ; map:member "mode" ] ,', "map:property"))
    first = http.get("/resources/arm/").headers["etag"]
    for word in ("automatic", "manual") * 2:
        mode(http, word)
        there = word == "manual"
        assert http.get("/resources/arm/hand/width").status_code == (200 if there else 404)
        answer = http.get("/resources/arm/", headers={"If-None-Match": first})
        assert answer.status_code == (304 if there else 200)
        assert there or not objects(answer, f"{EX}home")
        guarded = http.patch("/resources/arm/", json={"grip": 1}, headers={"If-Match": first, **MERGE})
        assert guarded.status_code == (204 if there else 412)
    arm.answer("/arm/get_mode", "made_up/srv/GetWords", words="automatic")  # moved by another client than rosld
    assert http.put("/resources/arm/grip", json=2).status_code == 409
    assert http.post("/resources/arm/home").status_code == 409


def test_an_action_that_ends_its_own_place_answers_with_the_one_above(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(
        http,
        SAFE + '<#hand> map:action [ map:relation ex:release ; map:name "release" ; map:service "/arm/hand/wave" ] .',
    )
    words = arm.variable("/arm/mode", "Words", words="manual")
    arm.offer("/arm/hand/wave", "std_srvs/srv/Trigger", lambda _: words.update(words="automatic") or {"success": True})
    answer = http.post("/resources/arm/hand/release", headers=JSON)
    assert answer.headers["content-location"] == f"{http.base_url}resources/arm/"
    assert (answer.status_code, answer.json()) == (200, {"grip": 1, "mode": "automatic"})
    assert http.get("/resources/arm/hand/release").status_code == 404
    assert http.get("/resources/arm/hand/").status_code == 404


def test_a_field_is_read_and_written_at_an_address_of_its_own(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    url = f"{http.base_url}resources/gripper/"
    assert f"{url}x" in objects(http.get(url), f"{LDP}contains")
    assert value(http, f"{url}x") == 1.0
    assert objects(http.get(f"{url}x"), f"{RDF}value") == {"1.0"}
    assert http.put(f"{url}x", json=4).status_code == 204
    assert value(http, "/resources/arm/pose")["pose"]["position"] == {"x": 4.0, "y": 2.0, "z": 3.0}
    assert http.patch(f"{url}y", json=5, headers=MERGE).status_code == 204
    turtle = f"<> <{RDF}value> 6 ."
    assert http.put(f"{url}x", content=turtle, headers=TURTLE).status_code == 204
    assert value(http, url) == {"force": 1, "x": 6.0, "y": 5.0}
    for wrong in ("far", True, {"x": 1}, [1]):
        assert http.put(f"{url}x", json=wrong).status_code == 422, wrong
    assert arm.calls["/arm/set_pose"] == 3
    assert http.get("/resources/arm/x").status_code == 404
    # The whole value that contains the field must be known.
    arm.break_off("/arm/get_pose")
    assert "must be known" in detail(http.put(f"{url}x", json=7), 409)
    assert arm.calls["/arm/set_pose"] == 3


def test_fields_of_one_message_written_in_parallel_lose_nothing(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    with ThreadPoolExecutor(8) as pool:
        for number in (10, 20):
            writes = [
                pool.submit(http.put, f"/resources/gripper/{axis}", json=number + place)
                for place, axis in enumerate(("x", "y"))
            ]
            assert [one.result().status_code for one in writes] == [204, 204]
            assert value(http, "/resources/gripper/") == {"force": 1, "x": number, "y": number + 1}


def test_a_missing_field_is_unreadable_and_the_others_are_not(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER.replace("pose.position.y", "pose.position.q"))
    url = f"{http.base_url}resources/gripper/"
    assert value(http, url) == {"force": 1, "x": 1.0, "q": None}
    assert "no" in "".join(objects(http.get(url), f"{ROS}unreadable", f"{url}q"))
    assert http.patch(url, json={"q": 1}, headers=MERGE).status_code == 422
    assert http.patch(url, json={"x": 2}, headers=MERGE).status_code == 204


def test_several_members_are_changed_by_one_patch_or_none(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    answer = http.patch("/resources/arm/", json={"grip": 5, "mode": "automatic"}, headers=MERGE)
    assert answer.status_code == 204
    assert value(http, "/resources/arm/") | {"pose": 0} == {"grip": 5, "mode": "automatic", "pose": 0}
    here = f"{http.base_url}resources/arm/"
    update = f"""DELETE {{ <{here}grip> <{RDF}value> ?g . <{here}mode> <{RDF}value> ?m }}
                 INSERT {{ <{here}grip> <{RDF}value> 6 . <{here}mode> <{RDF}value> "manual" }}
                 WHERE {{ <{here}grip> <{RDF}value> ?g . <{here}mode> <{RDF}value> ?m }}"""
    answer = http.patch("/resources/arm/", content=update, headers=UPDATE)
    assert answer.status_code == 204, answer.text
    assert value(http, "/resources/arm/") | {"pose": 0} == {"grip": 6, "mode": "manual", "pose": 0}
    assert arm.calls["/arm/set_pose"] == 0
    shown = http.patch(here, json={"grip": 7}, headers={**MERGE, **JSON, "Prefer": "return=representation"})
    assert (shown.status_code, shown.json()["grip"]) == (200, 7)
    writes = sum(arm.calls[name] for name in arm.calls if "/set_" in name)
    assert http.patch(here, json={}, headers=MERGE).status_code == 204
    assert http.patch(here, content=f"INSERT DATA {{ <{here}> <{EX}x> 1 }}", headers=UPDATE).status_code == 204
    patch: object
    for patch, words in (
        ({"mode": "automatic", "grip": 1000}, "grip"),
        ({"mode": "automatic", "grip": "tight"}, "grip"),
        ({"mode": "automatic", "none": 1}, "no such member"),
        ({"mode": "automatic", "grip": None}, "cannot be removed"),
        ({"mode": "automatic", "pose": {"pose": {"position": {"w": 1}}}}, "pose"),
        ([1], "expected an object"),
    ):
        refused = http.patch(here, json=patch, headers=MERGE)
        assert (refused.status_code, words in refused.text) == (422, True), (patch, refused.text)
    assert sum(arm.calls[name] for name in arm.calls if "/set_" in name) == writes, "all of it is written or nothing"


def test_a_patch_that_fails_midway_says_what_became_of_each_member(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/a", "Byte", value=1)
    robot.variable("/arm/b", "Byte", value=1)
    robot.answer("/arm/set_b", "made_up/srv/SetByte", success=False, message="stuck")
    robot.variable("/arm/c", "Byte", value=1)
    http = serving(freshness=60)
    assert value(http, "/resources/arm/") == {"a": 1, "b": 1, "c": 1}
    answer = http.patch("/resources/arm/", json={"a": 2, "b": 2, "c": 2}, headers=MERGE)
    assert answer.status_code == 422
    told = {one["name"]: one["status"] for one in answer.json()["members"]}
    assert told == {"a": 204, "b": 422, "c": 424}
    assert answer.json()["robotSaid"] == "stuck"
    assert answer.json()["detail"] == "b: /arm/set_b refused the value. Written before: a."
    assert value(http, "/resources/arm/") == {"a": 2, "b": 1, "c": 1}
    assert robot.calls["/arm/set_c"] == 0


def test_fields_of_one_message_are_changed_together(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    assert http.patch("/resources/gripper/", json={"x": 5, "y": 6}, headers=MERGE).status_code == 204
    assert arm.calls["/arm/set_pose"] == 1
    assert value(http, "/resources/arm/pose")["pose"]["position"] == {"x": 5.0, "y": 6.0, "z": 3.0}
    url = f"{http.base_url}resources/gripper/"
    update = f"DELETE {{ <{url}> <{EX}x> ?x }} INSERT {{ <{url}> <{EX}x> 7 }} WHERE {{ <{url}> <{EX}x> ?x }}"
    assert http.patch(url, content=update, headers=UPDATE).status_code == 204
    assert value(http, url) == {"force": 1, "x": 7.0, "y": 6.0}
    assert http.patch(url, json={"x": "far", "force": 9}, headers=MERGE).status_code == 422
    assert value(http, url) == {"force": 1, "x": 7.0, "y": 6.0}
    assert http.patch(url, json={"x": 8, "force": 9}, headers=MERGE).status_code == 204
    assert value(http, url) == {"force": 9, "x": 8.0, "y": 6.0}


def test_a_message_of_one_scalar_is_written_as_its_field_also_before_there_was_one(
    robot: MadeUp, serving: Serving
) -> None:
    robot.topic("/lamp/brightness", "std_msgs/msg/Float64", published=False, heard=True)
    http = serving()
    mapped(
        http,
        """<#lamp> a map:ComplexResource ; map:path "/lamp/" ; map:property
             [ map:predicate ex:light ; map:member "brightness" ; map:field "data" ; map:name "light" ] ,
             [ map:predicate ex:none ; map:member "brightness" ; map:field "level" ; map:name "none" ] .""",
    )
    assert http.put("/resources/lamp/light", json=0.5).status_code == 204
    assert value(http, "/topics/lamp/brightness") == {"data": 0.5}
    assert http.patch("/resources/lamp/", json={"light": 0.75}, headers=MERGE).status_code == 204
    url = f"{http.base_url}resources/lamp/light"
    assert objects(http.get(url), f"{RDF}value") == {"0.75"}
    said = http.get(url, headers={"Accept": "text/turtle"}).text
    assert "sh:datatype xsd:double" in said
    assert http.put("/resources/lamp/light", json="bright").status_code == 422
    assert http.put("/resources/lamp/none", json=1).status_code == 422


def test_what_has_two_conditions_is_on_offer_only_while_both_hold(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    light = '<#light> a sh:NodeShape ; map:about "/arm/grip" ; sh:property [ sh:path rdf:value ; sh:maxInclusive 5 ] .'
    mapped(http, SAFE.replace("map:availableWhen <#manual>", "map:availableWhen <#manual> , <#light>") + light)
    for word, grip, allowed in (("manual", 1, True), ("manual", 9, False), ("automatic", 1, False)):
        mode(http, "manual")
        assert http.put("/resources/arm/grip", json=grip).status_code == 204
        mode(http, word)
        assert bool(objects(http.get("/resources/arm/"), f"{EX}home")) is allowed, (word, grip)
        assert http.post("/resources/arm/home").status_code == (200 if allowed else 409), (word, grip)


def test_a_property_from_elsewhere_redirects_to_its_own_url(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, GRIPPER)
    here, there = (f"{http.base_url}resources/{path}" for path in ("gripper/force", "arm/grip"))
    for method in ("GET", "HEAD", "OPTIONS", "PUT", "PATCH"):
        answer = http.request(method, here, json=2)
        assert (answer.status_code, answer.headers["location"]) == (308, there), method
    assert http.put(here, json=7, follow_redirects=True).status_code == 204
    assert http.get(here, headers=JSON, follow_redirects=True).json() == 7
    assert http.get(f"{here}s").status_code == 404


def test_options_has_no_get_where_get_is_404(arm: MadeUp, serving: Serving) -> None:
    http = serving()
    mapped(http, SAFE)

    def allowed(path: str) -> set[str]:
        answer = http.options(f"/resources/arm/{path}")
        assert answer.status_code == 204
        methods = set(answer.headers["allow"].split(", "))
        assert {name for name in ("PATCH", "PUT", "POST") if f"accept-{name.lower()}" in answer.headers} <= methods
        return methods

    assert allowed("") == {"GET", "HEAD", "OPTIONS", "PATCH"}
    assert allowed("home") == {"GET", "HEAD", "OPTIONS", "POST"}
    assert allowed("hand/width") == {"GET", "HEAD", "OPTIONS", "PATCH", "PUT"}
    mode(http, "automatic")
    assert http.get("/resources/arm/home").status_code == 404
    assert allowed("home") == {"OPTIONS", "POST"}
    assert "not on offer" in detail(http.post("/resources/arm/home"), 409)
    for path in ("hand/", "hand/width", "hand/finger/length", "hand/wave"):
        assert http.get(f"/resources/arm/{path}").status_code == 404
        assert allowed(path) == {"OPTIONS"}, path
    assert "GET" in allowed("grip")  # it can be read, though not written now
