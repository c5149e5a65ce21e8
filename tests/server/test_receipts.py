"""Receipts over HTTP: every write creates one, clients can find it, and it reveals no secrets."""

from __future__ import annotations

import json
import re
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.stopping import release
from tests.waiting import until

JSON = {"Accept": "application/json"}
PROVENANCE = "http://www.w3.org/ns/prov#has_provenance"
UPDATE = {"Content-Type": "application/sparql-update"}


def receipt_url(answer: httpx.Response) -> str | None:
    """Return the URL of the receipt in a response."""
    found = re.findall(rf'<([^>]*)>; rel="{re.escape(PROVENANCE)}"', answer.headers.get("link", ""))
    assert len(found) <= 1
    return found[0] if found else None


@pytest.fixture(scope="module")
def receipt(plane: httpx.Client) -> Callable[[httpx.Response], dict[str, Any]]:
    """Return the receipt of a response, as plain JSON."""

    def read(answer: httpx.Response) -> dict[str, Any]:
        url = receipt_url(answer)
        assert url is not None, answer.headers
        told: dict[str, Any] = plane.get(url, headers=JSON).raise_for_status().json()
        assert told["status"] == answer.status_code
        return told

    return read


Receipt = Callable[[httpx.Response], dict[str, Any]]


def test_a_publish_tells_who_asked_what_it_came_to_and_who_heard_it(plane: httpx.Client, receipt: Receipt) -> None:
    told = receipt(plane.put("/topics/cockpit/display", json={"data": "climb"}))
    assert told["agent"] == "anybody"
    assert (told["method"], told["url"]) == ("PUT", f"{plane.base_url}topics/cockpit/display")
    assert told["plan"] == ["publish a std_msgs/msg/String on /cockpit/display"]
    assert told["touched"] == [f"{plane.base_url}topics/cockpit/display"]
    assert (told["matched"], told["excerpt"]) == (1, '{"data":"climb"}')
    assert told["started"] < told["ended"]


def test_a_client_may_say_why_it_writes_and_what_it_is(plane: httpx.Client, receipt: Receipt) -> None:
    words = {"Rosld-Reason": "Startfreigabe für\tuns".encode(), "Rosld-Client": b"autopilot"}
    answer = plane.put("/topics/cockpit/display", json={"data": "climb"}, headers=words)
    told = receipt(answer)
    assert (told["reason"], told["client"]) == ("Startfreigabe für uns", "autopilot")
    query = """SELECT ?reason ?client { ?w ros:reason ?reason ; prov:used/prov:wasAttributedTo ?p .
        ?p a prov:SoftwareAgent ; rdfs:label ?client }"""
    prefixes = "PREFIX prov: <http://www.w3.org/ns/prov#> PREFIX rdfs: <http://www.w3.org/2000/01/rdf-schema#> "
    (row,) = plane.post("/sparql", data={"query": prefixes + query}, headers=JSON).json()["results"]["bindings"]
    assert (row["reason"]["value"], row["client"]["value"]) == (told["reason"], told["client"])
    words = {"Rosld-Reason": "password=hunter2"}
    assert "hunter2" not in str(receipt(plane.put("/topics/cockpit/display", json={"data": "x"}, headers=words)))


TURTLE = {"Content-Type": "text/turtle"}
MERGE = {"Content-Type": "application/merge-patch+json"}
SET_H = "INSERT DATA { GRAPH </parameters/h> { </parameters/h> ros:value 10 } }"
HOLD = "topics/cockpit/display?rate=10&lease=0.1&then=none"
WRITES: tuple[tuple[str, str, dict[str, Any], str, str], ...] = (
    ("POST", "services/aircraft/start", {}, "call /aircraft/start (std_srvs/srv/Trigger)", "services/aircraft/start"),
    ("PUT", "resources/aircraft/power", {"json": "on"}, "call /aircraft/set_power", "services/aircraft/set_power"),
    ("PATCH", "resources/aircraft/", {"content": '{"power": "on"}', "headers": MERGE}, "call", "services/"),
    ("PUT", "parameters/a/b", {"json": 1}, "set the parameter /a/b", "parameters/a/b"),
    ("DELETE", "parameters/a/b", {}, "delete the parameter /a/b", "parameters/a/b"),
    ("POST", "actions/aircraft/fly", {"json": {"distance": 1}}, "send a goal to /aircraft/fly", "actions/aircraft/fly"),
    ("POST", HOLD, {"json": {"data": "held"}}, "hold /cockpit/display at 10 Hz", "topics/cockpit/display"),
    ("POST", "stop", {}, "stop the robot", "stop"),
    ("DELETE", "stop", {}, "let writes pass again", "stop"),
    ("PUT", "data/x", {"content": "<> <urn:p> 1 .", "headers": TURTLE}, "store /data/x", "data/x"),
    ("PUT", "graphs?graph=/data/x", {"content": "<> <urn:p> 2 .", "headers": TURTLE}, "store /data/x", "data/x"),
    ("DELETE", "data/x", {}, "delete /data/x", "data/x"),
    ("POST", "sparql", {"content": SET_H, "headers": UPDATE}, "set the parameter /h to 10", "parameters/h"),
)


def test_every_kind_of_write_leaves_a_receipt(plane: httpx.Client, receipt: Receipt) -> None:
    for method, path, sent, plan, touched in WRITES:
        is_release = (method, path) == ("DELETE", "stop")
        told = receipt(release(plane) if is_release else plane.request(method, path, **sent))
        assert any(step.startswith(plan) for step in told["plan"]), told
        assert any(url.startswith(f"{plane.base_url}{touched}") for url in told["touched"]), told


def test_a_file_has_its_digest_and_a_refusal_its_reason_in_the_receipt(plane: httpx.Client, receipt: Receipt) -> None:
    answer = plane.put("/data/photo", content=b"\x89PNG\xff" * 100_000, headers={"Content-Type": "image/png"})
    told = receipt(answer)
    assert (told["length"], told["made"]) == (500_000, f"{plane.base_url}data/photo")
    assert told["digest"].startswith("sha-256=:")
    assert "excerpt" not in told
    told = receipt(plane.put("/topics/cockpit/display", json={"data": 7}))
    assert (told["status"], "plan" in told, "touched" in told) == (422, False, False)
    assert "expected a string" in told["words"]


def test_a_form_tells_what_it_meant_and_nothing_of_its_token(plane: httpx.Client, receipt: Receipt) -> None:
    page = plane.get("/topics/cockpit/display", headers={"Accept": "text/html"}).text
    token = re.search(r'name="csrf" value="([^"]+)"', page)
    assert token is not None
    form = next(each for each in page.split("<form")[1:] if 'value="PUT"' in each)
    fields = dict(re.findall(r'name="(csrf|method)" value="([^"]*)"', form))
    field = re.search(r'<(?:input|textarea)[^>]*name="(data[^"]*|[^"]*data)"', form)
    assert field is not None, form
    answer = plane.post("/topics/cockpit/display", data={**fields, field[1]: "from a form"})
    assert answer.status_code == 303, answer.text
    told = receipt(answer)
    assert (told["method"], json.loads(told["excerpt"])) == ("PUT", {"data": "from a form"})
    assert token[1] not in json.dumps(told)


def test_reads_dry_runs_and_requests_that_are_not_understood_leave_no_receipt(plane: httpx.Client) -> None:
    update = {"content": "INSERT DATA { GRAPH </data/y> { <a:b> <a:b> 1 } }", "headers": UPDATE}
    requests: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("GET", "/topics/cockpit/display", {}),
        ("OPTIONS", "/topics/cockpit/display", {}),
        ("POST", "/sparql", {"data": {"query": "ASK {}"}}),
        ("POST", "/sparql?dry-run=true", update),
        ("PUT", "/nodes/aircraft", {"json": {}}),
        ("PUT", "/topics/cockpit/display", {"content": "x", "headers": {"Content-Type": "image/png"}}),
        ("DELETE", "/nothing/here", {}),
    )
    for method, path, sent in requests:
        assert receipt_url(plane.request(method, path, **sent)) is None, (method, path)


def test_credentials_are_nowhere(plane: httpx.Client, receipt: Receipt) -> None:
    secret = "correct-horse-battery"
    headers = {"Authorization": f"Bearer {secret}", "Cookie": f"session={secret}"}
    told = receipt(plane.put("/parameters/wifi/password", json=secret, headers=headers))
    assert told["withheld"] is True
    update = f'INSERT DATA {{ GRAPH </parameters/wifi/psk> {{ </parameters/wifi/psk> ros:value "{secret}" }} }}'
    assert receipt(plane.post("/sparql", content=update, headers=UPDATE))["plan"] == ["(withheld)"]
    receipt(plane.put("/parameters/aircraft/password", json={"a": [{"x": secret}]}))
    everything = plane.get("/activity/", headers={"Accept": "text/html"}).text
    asked = "SELECT ?o { ?w a ros:Write . GRAPH ?w { ?s ?p ?o } }"
    everything += plane.post("/sparql", data={"query": asked}, headers={"Accept": "text/csv"}).text
    assert "climb" in everything
    assert secret not in everything


def test_the_container_lists_the_newest_first_in_pages(plane: httpx.Client) -> None:
    urls = [receipt_url(plane.put("/topics/cockpit/display", json={"data": str(number)})) for number in range(5)]
    whole = contained(plane.get("/activity/", headers=JSON))
    assert whole[:5] == urls[::-1]
    first = plane.get("/activity/", headers={"Prefer": 'return=representation; max-member-count="2"', **JSON})
    assert first.status_code == 303
    page = plane.get(first.headers["location"], headers=JSON)
    plane.put("/topics/cockpit/display", json={"data": "meanwhile"})
    pages = [contained(page)]
    while "next" in page.links:
        page = plane.get(page.links["next"]["url"], headers=JSON)
        pages.append(contained(page))
    assert [each for page_ in pages for each in page_] == whole


def contained(answer: httpx.Response) -> list[str]:
    """Return the members of a container in JSON-LD, in order."""
    return re.findall(r'"(http[^"]*/activity/[A-Za-z0-9_-]+)"', answer.raise_for_status().text)


def test_receipts_are_streamed_as_they_come(plane: httpx.Client) -> None:
    with plane.stream("GET", "/activity/", headers={"Accept": "text/event-stream"}) as stream:
        lines = events(stream)
        next(lines)
        sent: list[str | None] = []
        threading.Thread(
            target=lambda: sent.append(
                receipt_url(httpx.put(f"{plane.base_url}topics/cockpit/display", json={"data": "s"}))
            )
        ).start()
        told = json.loads(next(lines))
    assert told["excerpt"] == '{"data":"s"}'


def events(stream: httpx.Response) -> Iterator[str]:
    return (line.removeprefix("data: ") for line in stream.iter_lines() if line.startswith("data: "))


def test_pages_link_to_receipts_which_cannot_be_written(plane: httpx.Client) -> None:
    url = receipt_url(plane.put("/topics/cockpit/display", json={"data": "<script>alert(1)</script>"}))
    assert url is not None
    html = {"Accept": "text/html"}
    assert "PUT /topics/cockpit/display" in plane.get("/activity/", headers=html).text.replace("<wbr>", "")
    page = plane.get(url, headers=html)
    assert (page.status_code, "<script>alert" in page.text) == (200, False)
    assert f"{plane.base_url}activity/" in plane.get("/", headers={"Accept": "text/turtle"}).text
    assert plane.get("/activity/never").status_code == 404
    assert plane.delete(url).status_code == plane.put(url, json={}).status_code == 405


@pytest.mark.slow
def test_receipts_survive_a_kill_and_an_orderly_end(tmp_path: Path, serve: Callable[..., Any]) -> None:
    database = tmp_path / "receipts.sqlite"
    crashing = serve("aircraft", "--data", str(tmp_path), process=True)
    put = crashing.http.put
    urls = [receipt_url(put("/topics/cockpit/display", json={"data": str(number)})) for number in range(30)]

    def written() -> bool:
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as reading:
            return bool(reading.execute("SELECT COUNT(*) FROM receipt").fetchone() == (30,))

    until(written, "30 receipts on the disk")
    crashing.process.kill()
    crashing.process.wait(60)
    for ending in ("orderly", "again"):
        served = serve("aircraft", "--data", str(tmp_path), "--port", str(httpx.URL(crashing.url).port))
        assert contained(served.http.get("/activity/", headers=JSON)) == urls[::-1]
        told = served.http.get(str(urls[0]), headers=JSON).json()
        assert told["plan"] == ["publish a std_msgs/msg/String on /cockpit/display"]
        urls.append(receipt_url(served.http.put("/topics/cockpit/display", json={"data": ending})))
        assert served.stop() == 0
