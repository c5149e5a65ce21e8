"""Receipts over HTTP: every write leaves one, whoever asks finds it, and it tells no secrets."""

from __future__ import annotations

import json
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.stopping import release

JSON = {"Accept": "application/json"}
PROVENANCE = "http://www.w3.org/ns/prov#has_provenance"
UPDATE = {"Content-Type": "application/sparql-update"}


def receipt_url(answer: httpx.Response) -> str | None:
    """Where an answer says that its receipt is."""
    found = re.findall(rf'<([^>]*)>; rel="{re.escape(PROVENANCE)}"', answer.headers.get("link", ""))
    assert len(found) <= 1
    return found[0] if found else None


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Any]) -> httpx.Client:
    """An aircraft of this module's own."""
    client: httpx.Client = start_server("aircraft").http
    return client


@pytest.fixture(scope="module")
def receipt(plane: httpx.Client) -> Callable[[httpx.Response], dict[str, Any]]:
    """The receipt of an answer, as plain JSON."""

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


@pytest.mark.parametrize(
    ("method", "path", "how", "plan", "touched"),
    [
        (
            "POST",
            "services/aircraft/start",
            {},
            "call /aircraft/start (std_srvs/srv/Trigger)",
            "services/aircraft/start",
        ),
        ("PUT", "resources/aircraft/power", {"json": "on"}, "call /aircraft/set_power", "services/aircraft/set_power"),
        ("PATCH", "resources/aircraft/", {"json": {"power": "on"}, "type": "merge-patch+json"}, "call", "services/"),
        ("PUT", "parameters/a/b", {"json": 1}, "set the parameter /a/b", "parameters/a/b"),
        ("DELETE", "parameters/a/b", {}, "delete the parameter /a/b", "parameters/a/b"),
        (
            "POST",
            "actions/aircraft/fly",
            {"json": {"distance": 1}},
            "send a goal to /aircraft/fly",
            "actions/aircraft/fly",
        ),
        (
            "POST",
            "topics/cockpit/display?rate=10&lease=0.1&then=none",
            {"json": {"data": "held"}},
            "hold /cockpit/display at 10 Hz",
            "topics/cockpit/display",
        ),
        ("POST", "stop", {}, "stop the robot", "stop"),
        ("DELETE", "stop", {}, "let writes pass again", "stop"),
        ("PUT", "data/x", {"content": "<> <http://e.x/p> 1 .", "type": "turtle"}, "store /data/x", "data/x"),
        (
            "PUT",
            "graphs?graph=/data/x",
            {"content": "<> <http://e.x/p> 2 .", "type": "turtle"},
            "store /data/x",
            "data/x",
        ),
        ("DELETE", "data/x", {}, "delete /data/x", "data/x"),
        (
            "POST",
            "sparql",
            {
                "content": "INSERT DATA { GRAPH </parameters/h> { </parameters/h> ros:value 10 } }",
                "type": "sparql-update",
            },
            "set the parameter /h to 10",
            "parameters/h",
        ),
    ],
)
def test_every_kind_of_write_leaves_a_receipt(
    plane: httpx.Client, receipt: Receipt, method: str, path: str, how: dict[str, Any], plan: str, touched: str
) -> None:
    kind = how.pop("type", None)
    headers = {} if kind is None else {"Content-Type": f"{'text' if kind == 'turtle' else 'application'}/{kind}"}
    is_release = (method, path) == ("DELETE", "stop")
    told = receipt(release(plane) if is_release else plane.request(method, path, headers=headers, **how))
    assert any(step.startswith(plan) for step in told["plan"]), told
    assert any(url.startswith(f"{plane.base_url}{touched}") for url in told["touched"]), told


def test_a_file_is_known_by_its_digest(plane: httpx.Client, receipt: Receipt) -> None:
    answer = plane.put("/data/photo", content=b"\x89PNG\xff" * 100_000, headers={"Content-Type": "image/png"})
    told = receipt(answer)
    assert (told["length"], told["made"]) == (500_000, f"{plane.base_url}data/photo")
    assert told["digest"].startswith("sha-256=:")
    assert "excerpt" not in told


def test_a_refusal_tells_why_and_touches_nothing(plane: httpx.Client, receipt: Receipt) -> None:
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


@pytest.mark.parametrize(
    ("method", "path", "how"),
    [
        ("GET", "/topics/cockpit/display", {}),
        ("OPTIONS", "/topics/cockpit/display", {}),
        ("POST", "/sparql", {"data": {"query": "ASK {}"}}),
        (
            "POST",
            "/sparql?dry-run=true",
            {"content": "INSERT DATA { GRAPH </data/y> { <a:b> <a:b> 1 } }", "headers": UPDATE},
        ),
        ("PUT", "/nodes/aircraft", {"json": {}}),
        ("PUT", "/topics/cockpit/display", {"content": "x", "headers": {"Content-Type": "image/png"}}),
        ("DELETE", "/nothing/here", {}),
    ],
)
def test_what_writes_nothing_and_what_is_not_understood_leaves_none(
    plane: httpx.Client, method: str, path: str, how: dict[str, Any]
) -> None:
    assert receipt_url(plane.request(method, path, **how)) is None


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


def test_receipts_are_in_the_dataset_with_the_stored_query_that_asks_for_them(plane: httpx.Client) -> None:
    url = receipt_url(plane.put("/topics/cockpit/display", json={"data": "level"}))
    rows = plane.get("/queries/who-moved-what", params={"format": "csv"}).text.splitlines()
    assert rows[0] == "when,who,what,did,receipt"
    assert rows[1].split(",")[1:] == [
        "anybody",
        f"{plane.base_url}topics/cockpit/display",
        "publish a std_msgs/msg/String on /cockpit/display",
        url,
    ]
    plane.put("/topics/cockpit/display", json={"data": 7})
    assert plane.get("/queries/who-moved-what", params={"format": "csv"}).text.splitlines()[1:] == rows[1:]


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
    """What a container in JSON-LD contains, in its order."""
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


def test_pages_link_to_receipts_and_show_them(plane: httpx.Client) -> None:
    url = receipt_url(plane.put("/topics/cockpit/display", json={"data": "<script>alert(1)</script>"}))
    assert url is not None
    html = {"Accept": "text/html"}
    assert "PUT /topics/cockpit/display" in plane.get("/activity/", headers=html).text.replace("<wbr>", "")
    page = plane.get(url, headers=html)
    assert page.status_code == 200
    assert "<script>alert" not in page.text
    assert f"{plane.base_url}activity/" in plane.get("/", headers={"Accept": "text/turtle"}).text


def test_what_is_not_there_is_404_and_nothing_can_be_written(plane: httpx.Client) -> None:
    assert plane.get("/activity/never").status_code == 404
    url = receipt_url(plane.put("/parameters/q", json=1))
    assert url is not None
    assert plane.delete(url).status_code == plane.put(url, json={}).status_code == 405


def test_receipts_survive_an_orderly_end(tmp_path: Path) -> None:
    port = free_port()
    with running(tmp_path, port) as http:
        urls = [receipt_url(http.put("/topics/cockpit/display", json={"data": str(number)})) for number in range(30)]
    with running(tmp_path, port) as http:
        assert contained(http.get("/activity/", headers=JSON)) == urls[::-1]
        told = http.get(str(urls[-1]), headers=JSON).json()
        assert told["plan"] == ["publish a std_msgs/msg/String on /cockpit/display"]


def test_receipts_that_are_on_the_disk_survive_a_kill(tmp_path: Path) -> None:
    port, database = free_port(), tmp_path / "receipts.sqlite"
    with running(tmp_path, port, signal.SIGKILL) as http:
        urls = [receipt_url(http.put("/topics/cockpit/display", json={"data": str(number)})) for number in range(30)]
        for _ in range(500):
            with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as reading:
                if reading.execute("SELECT COUNT(*) FROM receipt").fetchone() == (30,):
                    break
            time.sleep(0.02)
    with running(tmp_path, port) as http:
        assert contained(http.get("/activity/", headers=JSON)) == urls[::-1]
        after = receipt_url(http.put("/topics/cockpit/display", json={"data": "again"}))
        assert contained(http.get("/activity/", headers=JSON)) == [after, *urls[::-1]]


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
        return port


@contextmanager
def running(folder: Path, port: int, ended_by: signal.Signals = signal.SIGTERM) -> Iterator[httpx.Client]:
    """The aircraft at a port, and what it keeps in a folder."""
    command = [sys.executable, "-m", "rosld", "serve", "aircraft", "--data", str(folder), "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        with httpx.Client(base_url=process.stdout.readline().strip()) as http:
            yield http
        process.send_signal(ended_by)
        assert process.wait(60) == (0 if ended_by is signal.SIGTERM else -ended_by)
