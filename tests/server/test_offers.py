"""Offers: what can be read and done at a URL, as one small JSON object that says how."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from jsonschema import Draft202012Validator

from tests.server.auth.conftest import rule, token, tokens
from tests.server.conftest import Served
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

OFFER = "application/vnd.rosld.offer+json"
JSON = {"Accept": "application/json"}
MAX_BYTES = 1024
PREFIXES = "PREFIX ros: <https://w3id.org/rosld#> PREFIX ldp: <http://www.w3.org/ns/ldp#>"
EVERYTHING = (
    f"{PREFIXES} SELECT DISTINCT ?url WHERE {{ {{ ?url a ros:Topic }} UNION {{ ?url a ros:Service }} UNION "
    "{ ?url a ros:Action } UNION { ?url a ros:Parameter } UNION { ?url a ros:Property } "
    "UNION { ?x <https://www.w3.org/2019/wot/td#hasActionAffordance>/<https://www.w3.org/2019/wot/td#hasForm>/"
    "<https://www.w3.org/2019/wot/hypermedia#hasTarget> ?target BIND(IRI(STR(?target)) AS ?url) } }"
)
SPEED_LIMIT = """
@prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix ros: <https://w3id.org/rosld#> .
@prefix twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#> .
@prefix vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> .
<#slow> a sh:NodeShape ; sh:targetClass <https://w3id.org/rosld/types/geometry_msgs/msg/Twist> ;
    sh:property [ sh:path twist:linear ; sh:node [ sh:property [ sh:path vector:x ; sh:maxInclusive 0.4 ] ] ] .
"""

AUTH = tokens("reader", "driver") + rule("reader", "read", "/**") + rule("driver", "read control", "/**")


@pytest.fixture(scope="module")
def http(start_server: Callable[..., Served]) -> httpx.Client:
    """The embedded rover, which nobody has mapped."""
    return start_server("rover").http


def offer(http: httpx.Client, url: str) -> dict[str, Any]:
    answer = http.get(url, params={"offer": ""})
    assert (answer.status_code, answer.headers["content-type"]) == (200, OFFER), answer.text
    found: dict[str, Any] = answer.json()
    return found


def urls(http: httpx.Client) -> list[str]:
    """Return the URL of everything that the robot has and that can be read or done."""
    rows = http.get("/sparql", params={"query": EVERYTHING}, headers={"Accept": "text/csv"}).text.split()[1:]
    assert len(rows) > 30
    return rows


def test_the_offer_of_all_that_a_rover_has_is_small_and_its_example_is_accepted(http: httpx.Client) -> None:
    """Each example fits its schema, and a dry run of each operation with it is planned, so that nothing moves."""
    tried = 0
    for url in urls(http):
        answer = http.get(url, params={"offer": ""})
        found = answer.json()
        assert found["url"] == url
        assert len(answer.content) <= MAX_BYTES, (len(answer.content), found)
        assert "read" in found or "do" in found, found
        if "input" in found:
            Draft202012Validator.check_schema(found["input"])
            Draft202012Validator(found["input"]).validate(found["example"])
        for one in found.get("do", ()):
            body = (
                {"content": json.dumps(one.get("example", found["example"]))}
                if "input" in found and one["method"] != "DELETE"
                else {}
            )
            headers = {"Content-Type": one.get("contentType", "application/json")} if body else {}
            rate = "&rate=10" if "rate" in one.get("query", {}) else ""
            plan = http.request(one["method"], f"{url}{found['dryRun']}{rate}", headers=headers, **body)
            if one["method"] == "DELETE" and plan.status_code == 409:  # there is no goal to cancel
                continue
            assert (plan.status_code, plan.json().get("dryRun")) == (200, True), (url, one, plan.text)
            tried += 1
    assert tried > 20


def test_a_small_value_is_in_the_offer_and_a_large_one_says_its_size_and_what_else_there_is(
    http: httpx.Client,
) -> None:
    small = offer(http, "/parameters/rover/max_speed")
    assert small["read"] == {"bytes": 3, "value": 0.5, "wait": "?until=value > 0&timeout=60"}
    assert (small["input"]["minimum"], small["input"]["maximum"], small["example"]) == (0.1, 1.0, 0.5)
    picture = until(lambda: offer(http, "/topics/camera/image_raw")["read"].get("types") and offer(
        http, "/topics/camera/image_raw"), "a picture")  # fmt: skip
    assert picture["read"]["bytes"] > 50_000
    assert "image/jpeg" in picture["read"]["types"]
    assert "?width=" in picture["read"]["also"]
    assert "does not command it" in picture["refuses"]


def test_an_offer_is_had_by_media_type_and_linked_and_json_stays_the_value_of_ros(http: httpx.Client) -> None:
    url = "/parameters/rover/max_speed"
    plain = http.get(url, headers=JSON)
    assert plain.json() == 0.5
    named = httpx.Response(200, headers=plain.headers).links["service-desc"]
    assert (named["url"], named["type"]) == (f"{http.base_url}{url[1:]}?offer", OFFER)
    by_type = http.get(url, headers={"Accept": f"{OFFER}, application/json;q=0.5"})
    assert by_type.headers["content-type"] == OFFER
    assert by_type.json() == http.get(named["url"]).json()
    again = http.get(named["url"], headers={"If-None-Match": by_type.headers["etag"]})
    assert again.status_code == 304
    assert http.get(url, params={"offer": "perhaps"}).status_code == 400
    assert http.get("/topics/none", params={"offer": ""}).status_code == 404


def test_the_json_of_calls_goals_and_holds_names_their_offers(http: httpx.Client) -> None:
    goal = http.post("/actions/navigate_to", json=offer(http, "/actions/navigate_to")["example"], headers=JSON)
    call = http.post("/services/set_lights", json=offer(http, "/services/set_lights")["example"], headers=JSON)
    hold = http.post("/topics/cmd_vel?for=5", json=offer(http, "/topics/cmd_vel")["example"], headers=JSON)
    for made in (goal, call, hold):
        location = made.headers["location"]
        assert http.get(location, headers=JSON).json()["offer"] == f"{location}?offer"
        methods = {each["method"] for each in offer(http, location)["do"]}
        assert methods == ({"PATCH", "DELETE"} if made is hold else {"DELETE"})
    assert http.delete(hold.headers["location"]).status_code == 204


def test_the_offers_of_containers_list_their_members_and_those_of_resources_lead_on(http: httpx.Client) -> None:
    entry = offer(http, "/")
    assert {"topics/", "actions/", "resources/"} <= {*entry["members"]}
    assert (entry["search"], entry["help"]) == (f"{http.base_url}find", f"{http.base_url}llms.txt")
    assert {"cmd_vel", "odom", "camera/"} <= {*offer(http, "/topics/")["members"]}
    whole = offer(http, "/resources/")["offers"]
    assert f"{http.base_url}resources/lights?offer" in whole["PUT"]
    assert f"{http.base_url}resources/navigate_to?offer" in whole["POST"]
    assert http.get(whole["GET"][0]).status_code == 200


def test_while_the_robot_is_stopped_its_offers_say_so(http: httpx.Client) -> None:
    assert http.post("/stop").status_code == 200
    try:
        assert offer(http, "/services/set_lights")["refuses"] == "The robot is stopped."
        assert "do" not in offer(http, "/services/set_lights")
        assert {each["method"] for each in offer(http, "/topics/cmd_vel")["do"]} == {"PUT", "POST"}, "zero passes"
    finally:
        assert release(http).status_code == 204


def test_the_offer_has_the_bounds_of_limits(serve: Callable[..., Served], tmp_path: Any) -> None:
    (tmp_path / "slow.ttl").write_text(SPEED_LIMIT)
    http = serve("rover", "--shapes", str(tmp_path / "slow.ttl")).http
    found = offer(http, "/topics/cmd_vel")
    validator = Draft202012Validator(found["input"])
    assert validator.is_valid({"linear": {"x": 0.4}})
    assert not validator.is_valid({"linear": {"x": 0.5}})
    assert http.put("/topics/cmd_vel?dry-run=true", json={"linear": {"x": 0.5}}).status_code == 422


def test_an_agent_is_offered_what_it_may_do(serve: Callable[..., Served], tmp_path: Any) -> None:
    rules = tmp_path / "auth.toml"
    rules.write_text(AUTH)
    http = serve("rover", "--auth", str(rules)).http
    reader, driver = ({"Authorization": f"Bearer {token(name)}"} for name in ("reader", "driver"))
    assert "do" not in http.get("/topics/cmd_vel?offer", headers=reader).json()
    assert "refuses" not in http.get("/topics/cmd_vel?offer", headers=reader).json()
    may = http.get("/topics/cmd_vel?offer", headers=driver).json()["do"]
    assert {each["method"] for each in may} == {"PUT", "POST"}
    assert "POST" not in http.get("/resources/?offer", headers=reader).json().get("offers", {})
    assert http.get("/topics/odom?offer").status_code == 401


def test_who_knows_offers_flies_the_aircraft_to_300_and_90_in_eight_requests(serve: Callable[..., Served]) -> None:
    """It knows one URL: the entry leads to the search, that to what can be invoked and set, and offers say how."""
    http = serve("aircraft").http
    sizes = list[int]()

    def ask(method: str, url: str, **more: Any) -> Any:
        answer = http.request(method, url, headers=JSON, **more)
        assert answer.is_success, answer.text
        sizes.append(len(answer.content) + len(answer.request.content))
        return answer.json() if answer.content else None

    search = ask("GET", "/?offer=")["search"]
    found = [one["resource"] for one in ask("GET", search, params={"q": "aircraft"})["results"] if "resource" in one]
    start, speed = (next(url for url in found if url.endswith(f"/{name}")) for name in ("start", "speed"))
    ask("POST", start)
    offered = ask("GET", f"{speed}?offer=")
    for wanted in (300, 90):
        assert offered["input"]["minimum"] <= wanted <= offered["input"]["maximum"]
        [change] = offered["do"]
        ask(change["method"], offered["url"], json=wanted)
        reached = ask("GET", offered["url"], params={"until": f"value = {wanted}", "timeout": "60"})
        assert reached == wanted
    assert len(sizes) == 8
    assert sum(sizes) <= 12_000, sizes
