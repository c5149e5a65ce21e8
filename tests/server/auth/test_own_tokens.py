"""Tokens of rosld in the wrong places of requests: they appear in nothing that rosld writes."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from rosld.server.auth.tokens import generate_token
from rosld.server.http.token_redaction import PLACEHOLDER, contains_token
from tests.stopping import release

pytestmark = pytest.mark.slow

TOKEN = "rosld_S18GwepwBtiQPG1TbT9Ds-VaGrpqB_7tcmN9QmWM7yE"
"""Tokens as created by `rosld token add`."""
ENCODED = quote(TOKEN).replace("rosld_", "%72osld%5F")
UPDATE = {"Content-Type": "application/sparql-update"}
TURTLE = {"Content-Type": "text/turtle"}
LITERAL = f'INSERT DATA {{ GRAPH </parameters/n> {{ </parameters/n> ros:value "{TOKEN}" }} }}'
GRAPH = f"INSERT DATA {{ GRAPH </topics/{TOKEN}> {{ <a:b> <a:b> 1 }} }}"
ACCEPTED = ("application/json", "text/turtle", "text/html", "application/ld+json", "application/rdf+xml")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("log") / "stderr"


@pytest.fixture(scope="module")
def plane(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """An aircraft with a readable log."""
    data = tmp_path_factory.mktemp("data")
    command = [sys.executable, "-m", "rosld", "serve", "aircraft", "--port", "0", "--data", str(data)]
    with log.open("w") as written:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=written, text=True)
        assert process.stdout is not None
        with httpx.Client(base_url=process.stdout.readline().strip(), timeout=15) as client:
            yield client
        process.send_signal(signal.SIGTERM)
        assert process.wait(15) == 0


WRITES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("PUT", "/topics/cockpit/display", {"json": {"data": TOKEN}}),
    ("PUT", "/topics/cockpit/display", {"json": {"data": "x" * 1990 + TOKEN}}),
    ("PUT", "/parameters/note", {"json": f"with {TOKEN} in it", "headers": {"Prefer": "return=minimal"}}),
    ("POST", "/sparql", {"content": LITERAL, "headers": UPDATE}),
    ("POST", "/sparql", {"content": GRAPH, "headers": UPDATE}),
    ("PUT", f"/data/{TOKEN}", {"content": "<> a <#T> .", "headers": TURTLE}),
    ("PUT", f"/data/{ENCODED}", {"content": "<> a <#T> .", "headers": TURTLE}),
    ("PUT", f"/data/x?access_token={TOKEN}", {"content": "<> a <#T> .", "headers": TURTLE}),
    ("DELETE", f"/data/{TOKEN}", {}),
    ("PUT", f"/parameters/{TOKEN}", {"json": 1}),
    ("POST", "/data/", {"content": "<> a <#T> .", "headers": {**TURTLE, "Slug": f"my {TOKEN}"}}),
    ("POST", "/stop", {"json": {"reason": TOKEN}}),
    ("DELETE", "/stop", {}),
    ("PUT", "/topics/cockpit/display", {"json": {"data": 1, TOKEN: 2}}),
    ("POST", f"/topics/cockpit/display?rate=1&then={TOKEN}", {"json": {"data": "x"}}),
    ("PUT", "/topics/cockpit/display", {"content": "{}", "headers": {"Content-Type": f"application/{TOKEN}"}}),
    ("PUT", "/topics/cockpit/display", {"content": TOKEN, "headers": {"Content-Type": "application/json"}}),
)  # fmt: skip
READS = (
    f"/{TOKEN}", f"/topics/{TOKEN}", f"/data/{TOKEN}", f"/data/{ENCODED}", f"/topics/?format={TOKEN}",
    f"/topics/?page={ENCODED}", f"/resources/{TOKEN}/x", f"/sparql?query={TOKEN}", f"/graphs?graph=/data/{TOKEN}",
    f"/queries/{TOKEN}", f"/types/{TOKEN}/msg/X", f"/holds/{TOKEN}", f"/calls/{TOKEN}", f"/channels/{TOKEN}",
)  # fmt: skip


def said(answer: httpx.Response) -> str:
    return f"{answer.headers}{answer.text}"


def test_a_token_that_is_sent_is_in_no_answer_receipt_or_log(plane: httpx.Client, log: Path) -> None:
    for method, path, how in WRITES:
        answer = plane.request(method, path, **how)
        assert answer.status_code != 500
        assert TOKEN[6:] not in said(answer), answer.text
        found = re.findall(r"<([^>]*)>; rel=\"http://www.w3.org/ns/prov#has_provenance", answer.headers["link"])
        for url in found:
            for accept in ACCEPTED:
                assert TOKEN[6:40] not in plane.get(url, headers={"Accept": accept}).text
        assert found or answer.status_code in (404, 415)
        assert TOKEN[6:40] not in log.read_text()
        assert TOKEN[6:40] not in plane.get("/activity/", headers={"Accept": "text/html"}).text
        if (method, path) == ("POST", "/stop"):
            release(plane)


def test_a_token_in_a_url_is_not_echoed(plane: httpx.Client) -> None:
    for accept in ACCEPTED:
        for path in READS:
            answer = plane.get(path, headers={"Accept": accept})
            assert answer.status_code == 400
            assert "Authorization" in answer.text
            assert TOKEN[6:] not in said(answer)


def test_receipts_have_a_placeholder_also_in_the_dataset(plane: httpx.Client) -> None:
    answer = plane.put(f"/data/{TOKEN}", content="", headers=TURTLE)
    url = answer.links["http://www.w3.org/ns/prov#has_provenance"]["url"]
    assert plane.get(url, headers={"Accept": "application/json"}).json()["url"].endswith(f"/data/{PLACEHOLDER}")
    asked = "SELECT ?o { ?w a ros:Write . GRAPH ?w { ?s ?p ?o } }"
    told = plane.post("/sparql", data={"query": asked}, headers={"Accept": "text/csv"}).text
    assert PLACEHOLDER in told
    assert TOKEN[6:40] not in told


def test_names_of_ros_that_look_a_little_like_a_token_are_names(plane: httpx.Client) -> None:
    for name in ("rosld_a", "rosld_" + "long_name_of_a_robot_" * 3, "rosld_" + "x" * 43):
        assert plane.put(f"/parameters/{name}", json=name).status_code == 201
        assert plane.get(f"/parameters/{name}", headers={"Accept": "application/json"}).json() == name


def test_every_token_that_is_made_is_recognised() -> None:
    assert all(contains_token(f"x{generate_token()}.") for _ in range(2000))
