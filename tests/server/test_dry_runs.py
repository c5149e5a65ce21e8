"""Dry runs: every write can be planned and checked without any effect."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from mcap.writer import Writer

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.crawl.description import inlined
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.server.test_mappings import COCKPIT
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

UPDATE = "application/sparql-update"
TURTLE = {"Content-Type": "text/turtle"}
QUERY_TEXT = {"Content-Type": "application/sparql-query"}
WRITES = ("put", "post", "patch", "delete")
COMMANDS = frozenset(
    {
        *("publish", "advertise", "unadvertise", "call", "send_goal", "cancel_goal", "cancel_goals"),
        *("change_state", "set_parameters", "delete_parameters"),
    }
)
ENDED = ("succeeded", "aborted", "rejected")
ACCEPT_JSON = {"Accept": "application/json"}
DRY = {"dry-run": "true"}
HAS_PROVENANCE = "http://www.w3.org/ns/prov#has_provenance"
NOTIFY = "https://www.w3.org/ns/solid/notifications"
CHANNELS = ("WebSocketChannel2023", "StreamingHTTPChannel2023")
QUERY = "# Nothing in particular.\nSELECT * WHERE { ?s ?p ?o } LIMIT 1"
LIMITS = """
@prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
<#dry> a sh:NodeShape ; sh:targetNode <../resources/nowhere> ; sh:property [ sh:path rdf:value ; sh:maxInclusive 1 ] .
"""
KEPT_THERE = ("data", "mappings", "shapes", "cockpit")
LISTINGS = ("data", "mappings", "queries", "shapes", "cockpit", "holds", "calls", "goals", "bags", "activity")
KEPT = (*(f"/{name}/" for name in LISTINGS), *(f"/{name}/dry" for name in LISTINGS[:5]))
AGES = r"T\d\d:\d\d:\d\d[.0-9]*Z"


class Told:
    """Any adapter, with its calls recorded, except reads by getters."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self.told: list[str] = []

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._adapter, name)
        if name not in COMMANDS:
            return found

        async def noted(*arguments: Any, **named: Any) -> Any:
            if "/get_" not in str(arguments[0]):
                self.told.append(f"{name} {arguments[0]}")
            return await found(*arguments, **named)

        return noted


def described_writes(http: httpx.Client) -> Iterator[tuple[str, str]]:
    """Yield the method and the path of every write that the description lists."""
    for path, item in inlined(http.get("/openapi.json").json()).items():
        for method in WRITES:
            if method in item:
                names = [one["name"] for one in item[method]["parameters"]]
                assert "dry-run" in names, (method, path)
                yield method.upper(), path


def stand_ins(http: httpx.Client, action: str, service: str) -> dict[str, str]:
    """Return paths for templates: of resources created here, so that they can be changed and deleted."""
    for root in KEPT_THERE:
        http.put(f"/{root}/dry", content=sent_to(http, root), headers=TURTLE).raise_for_status()
    http.put("/queries/dry", content=QUERY, headers=QUERY_TEXT).raise_for_status()
    made = {
        "/calls/{id}": path_of(http.post(f"/services{service}", json={})),
        "/goals/{id}": httpx.URL(http.post(f"/actions{action}", json={}).headers["location"]).path,
    }
    for kind in CHANNELS:
        made[f"/channels/{kind}/{{token}}"] = path_of(http.post(f"/channels/{kind}", json=wish(http, kind)))
    return made


def sent_to(http: httpx.Client, root: str) -> str:
    """Return Turtle that may be stored below a route."""
    if root == "cockpit":
        default = http.get("/cockpit/default", headers={"Accept": "text/turtle"}).text
        return default.replace("/cockpit/default", "/cockpit/dry")
    return {"mappings": COCKPIT, "shapes": LIMITS}.get(root, "<> <urn:p> 1 .")


def path_of(answer: httpx.Response) -> str:
    """Return the path of a created resource."""
    assert answer.status_code == 201, answer.text
    return httpx.URL(answer.headers["location"]).path


def wish(http: httpx.Client, kind: str) -> dict[str, Any]:
    """Return a request for a channel."""
    type = f"{NOTIFY.replace('https', 'http')}#{kind}"
    return {"@context": [f"{NOTIFY}-context/v1"], "type": type, "topic": str(http.base_url.join("/topics/"))}


def ask_dry(http: httpx.Client, method: str, path: str) -> httpx.Response:
    """Send a valid write as a dry run."""
    params: dict[str, Any] = dict(DRY)
    headers: dict[str, str] = {}
    content: bytes | str = b""
    root = path.split("/")[1]
    if method == "DELETE":
        pass
    elif root in ("data", "mappings", "shapes", "cockpit", "graphs", "sparql"):
        about = f"{http.base_url}data/dry" if root in ("graphs", "sparql") else str(http.base_url.join(path))
        insertion = f"<{about}> <urn:p> 2"
        headers["Content-Type"] = UPDATE if method == "PATCH" or root == "sparql" else "text/turtle"
        content = f"INSERT DATA {{ {insertion} }}" if method == "PATCH" else f"{insertion} ."
        if root == "sparql":
            content = f"INSERT DATA {{ GRAPH <{about}> {{ {insertion} }} }}"
        elif method == "PUT" and path.endswith("/"):
            content = http.get(path, headers={"Accept": "text/turtle"}).text
        elif method != "PATCH":
            content = sent_to(http, root)
    elif root == "queries":
        headers["Content-Type"] = UPDATE if method == "PATCH" else "application/sparql-query"
        content = QUERY
        if path == "/queries/" and method != "POST":
            content = f"INSERT DATA {{ <{http.base_url}queries/> <urn:p> 2 }}"
            if method == "PUT":
                content, headers["Content-Type"] = http.get(path, headers={"Accept": "text/turtle"}).text, "text/turtle"
    elif root == "bags" and method == "PUT":
        content, headers["Content-Type"] = recording(), "application/octet-stream"
    else:
        headers["Content-Type"] = "application/merge-patch+json" if method == "PATCH" else "application/json"
        content = json.dumps(value_for(http, method, path))
    if root == "graphs":
        params["graph"] = f"{http.base_url}data/dry"
    if root == "topics" and method == "POST":
        params["rate"] = 2
    if method == "PATCH" and root == "topics":
        headers["If-Match"] = "*"
    return http.request(method, path, params=params, headers=headers, content=content)


def value_for(http: httpx.Client, method: str, path: str) -> Any:
    """Return the JSON of a valid write to the robot: the current value, or defaults."""
    root = path.split("/")[1]
    if root == "channels":
        return wish(http, path.split("/")[2])
    if root == "bags":
        return {"topics": ["/*"], "duration": 1}
    if root == "parameters" and method == "POST":
        return 5
    if root in ("topics", "services", "actions", "stop", "holds") or method == "POST":
        return {}
    there = http.get(path, headers={"Accept": "application/json"})
    return there.json() if there.status_code == 200 else 1


def recording() -> bytes:
    """Return an MCAP file without messages."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start("ros1", "")
    writer.finish()
    return file.getvalue()


def kept(http: httpx.Client) -> dict[str, str]:
    """Return all stored data, including receipts."""
    found = {path: http.get(path, headers={"Accept": "text/turtle"}).text for path in KEPT}
    for path in ("/stop", "/parameters/"):
        found[path] = http.get(path, headers={"Accept": "application/json"}).text
    return {path: re.sub(AGES, "", text) for path, text in found.items()}


def run_all_dry(http: httpx.Client, stand_ins: dict[str, str]) -> list[tuple[str, str, httpx.Response]]:
    """Send every described write as a dry run; return the responses."""
    found = []
    for method, template in described_writes(http):
        if template == "/holds/{id}":
            continue  # a hold would block other writes of its topic
        path = stand_ins.get(template) or re.sub(r"\{(name|path)\}", "dry", template)
        if template in ("/bags/{name}", "/topics/{name}", "/parameters/{name}"):
            path = path.replace("dry", "never_made")
        found.append((method, path, ask_dry(http, method, path)))
    return found


REFUSED = {
    *{("POST", "/cockpit/"), ("POST", "/mappings/"), ("POST", "/mappings/dry")},  # the body there is invalid
    *{("PATCH", "/parameters/never_made"), ("PUT", "/topics/never_made"), ("DELETE", "/topics/never_made")},
    ("DELETE", "/resources/aircraft/fly"),  # no goal is pursued
    *{("POST", "/resources/aircraft/start"), ("POST", "/services/aircraft/set_power")},
    ("PATCH", "/resources/"),  # a member is read-only
    *{("PATCH", "/faults/{id}"), ("DELETE", "/faults/{id}")},  # nothing is wrong
}
"""Writes that are refused with the bodies of this test."""


def test_a_dry_run_of_each_described_write_does_nothing(tmp_path: Path) -> None:
    adapter = Told(adapter_for("aircraft", AdapterOptions()))
    with served(adapter, data=tmp_path / "kept") as http:
        http.timeout = 60
        assert http.put("/topics/cockpit/display", json={}).status_code == 204
        http.post("/resources/aircraft/start")
        made = stand_ins(http, "/aircraft/fly", "/aircraft/get_power")
        until(
            lambda: http.get(made["/goals/{id}"], headers=ACCEPT_JSON).json()["status"] in ENDED, "the end of the goal"
        )
        before = kept(http)
        adapter.told.clear()
        answers = run_all_dry(http, made)
        assert adapter.told == []
        assert kept(http) == before
        for method, path, answer in answers:
            assert HAS_PROVENANCE not in answer.links, (method, path)
            if answer.status_code != 200:
                assert (method, path) in REFUSED, (method, path, answer.text)
            else:
                told = answer.json()
                assert (told["dryRun"], told["method"]) == (True, method)
                assert told["steps"] or method == "PATCH", (method, path)  # of existing resources


def test_a_plan_says_who_would_get_it_what_was_checked_and_what_the_answer_would_be(http: httpx.Client) -> None:
    base = str(http.base_url)
    plan = http.put("/topics/cockpit/display", params=DRY, json={"data": "x"}).json()
    (step,) = plan["steps"]
    assert step["does"] == "publish a std_msgs/msg/String on /cockpit/display"
    assert (step["url"], step["receivers"]) == (f"{base}topics/cockpit/display", [f"{base}nodes/cockpit"])
    assert (plan["url"], plan["status"]) == (f"{base}topics/cockpit/display", 204)
    plan = http.put("/resources/aircraft/power", params=DRY, json="on").json()
    assert [step["receivers"] for step in plan["steps"]] == [[f"{base}nodes/aircraft"]]
    assert plan["limits"] == [f"{base}resources/aircraft/power"]
    assert plan["conditions"] == [f"{base}mappings/aircraft#standing"]
    assert http.put("/parameters/never/made", params=DRY, json=1).json()["status"] == 201
    assert http.put("/parameters/aircraft/seats", params=DRY, json=4).json()["status"] == 204
    assert http.get("/parameters/never/made").status_code == 404


REFUSALS: tuple[tuple[str, str, dict[str, Any], int], ...] = (
    ("PUT", "/topics/cockpit/display", {"json": {"date": "x"}}, 422),
    ("PUT", "/topics/cockpit/display", {"content": b"{", "headers": {"Content-Type": "application/json"}}, 400),
    ("PUT", "/topics/aircraft/engine/speed", {"json": {"data": 1}}, 405),
    ("PUT", "/topics/cockpit/display", {"json": {}, "headers": {"If-None-Match": "*"}}, 412),
    ("POST", "/services/nowhere", {"json": {}}, 404),
    ("POST", "/resources/aircraft/stop", {"json": {}}, 409),
    ("DELETE", "/data/full/", {}, 409),
    ("PUT", "/data/full/one", {"content": "<> <urn:p> 1 .", "headers": {**TURTLE, "If-None-Match": "*"}}, 412),
    ("PUT", "/bags/broken", {"content": b"no recording"}, 422),
    ("PUT", "/queries/broken", {"content": b"SELEKT", "headers": QUERY_TEXT}, 422),
)


def test_a_dry_run_is_refused_as_the_write_would_be(http: httpx.Client) -> None:
    http.put("/data/full/one", content="<> <urn:p> 1 .", headers=TURTLE)
    for method, path, how, status in REFUSALS:
        answer = http.request(method, path, params=DRY, **how)
        assert answer.status_code == status, (method, path, answer.text)
        refused = http.request(method, path, **how)
        assert (refused.status_code, refused.json()["detail"]) == (status, answer.json()["detail"])


def test_while_the_robot_is_stopped_a_dry_run_is_refused_and_its_stop_stops_nothing(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    plan = http.post("/stop", params=DRY).json()
    assert 'publish on /cockpit/display with {"data": "stopped"}' in [step["does"] for step in plan["steps"]]
    assert http.get("/stop", headers=ACCEPT_JSON).json()["stopped"] is False
    assert http.post("/stop").status_code == 200
    for path in ("/topics/cockpit/display", "/services/aircraft/start", "/actions/aircraft/fly"):
        assert http.request("PUT" if "topics" in path else "POST", path, params=DRY, json={}).status_code == 423, path
    assert http.delete("/stop", params=DRY).status_code == 428, "nobody confirms it"
    assert release(http, **DRY).json()["status"] == 204
    assert http.get("/stop", headers=ACCEPT_JSON).json()["stopped"] is True


def test_a_dry_run_consumes_no_idempotency_key_and_counts_against_no_rate(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    assert http.post("/resources/aircraft/start").status_code == 200
    key = {"Idempotency-Key": "once"}
    bodies: dict[str, tuple[object, object]] = {
        "/services/aircraft/set_power": ({"data": "off"}, {"data": "on"}),
        "/actions/aircraft/fly": ({"distance": 1}, {"distance": 2}),
    }
    for path, (body, other) in bodies.items():
        assert http.post(path, params=DRY, json=body, headers=key).json()["status"] == 201
        made = http.post(path, json=other, headers=key)
        assert made.status_code == 201, made.text
        again = http.post(path, params=DRY, json=other, headers=key)  # it would receive the first outcome
        assert (again.json()["status"], again.json()["steps"]) == (201, [])
        assert http.post(path, params=DRY, json=body, headers=key).status_code == 422
    for _ in range(120):  # more than --max-publish-rate, in a burst
        assert http.put("/topics/cockpit/display", params=DRY, json={}).status_code == 200
    assert http.put("/topics/cockpit/display", json={}).status_code == 204


def test_a_hold_goes_on_as_it_was_after_dry_runs_of_its_change_and_its_end(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/drive", "geometry_msgs/msg/Twist", published=False, heard=True)
    http = serving()
    held = http.post("/topics/drive", json={}, params={"rate": 50, "lease": 5}).headers["location"]
    assert http.patch(held, params={**DRY, "rate": "5"}).json()["steps"][0]["does"].startswith("hold /drive at 5 Hz")
    assert http.delete(held, params=DRY).json()["status"] == 204
    assert http.get(held, headers=ACCEPT_JSON).json()["rate"] == 50
    assert http.post("/topics/drive", json={}, params=DRY).status_code == 409, "it is held"


def test_the_form_of_a_page_can_be_run_dry(http: httpx.Client) -> None:
    page = http.get("/topics/cockpit/display", headers={"Accept": "text/html"}).text
    hidden = dict(re.findall(r'<input type="hidden" name="([^"]+)" value="([^"]*)">', page.split('value="PUT"')[0]))
    fields = {**hidden, "method": "PUT", "data": "from a form"}
    answer = http.post("/topics/cockpit/display", params=DRY, data=fields)
    assert (answer.status_code, answer.json()["status"]) == (200, 303), answer.text
