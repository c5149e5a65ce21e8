"""Former versions of documents: mementos of writes, limited, durable, deleted on request."""

from __future__ import annotations

from collections.abc import Callable
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from rosld.server.http.fields import parse_links

TURTLE = {"Content-Type": "text/turtle"}
NTRIPLES = {"Accept": "application/n-triples"}
JSON = {"Accept": "application/json"}
PLAN = "/data/plan"
P = "http://example.org/step"


def put(http: Any, number: int, path: str = PLAN) -> None:
    answer = http.put(path, content=f"<> <{P}> {number} .", headers=TURTLE)
    assert answer.status_code in (201, 204), answer.text


def mementos(http: Any, path: str = PLAN) -> list[Any]:
    """Return the mementos in the TimeMap of a document."""
    answer = http.get(f"{path}?timemap")
    assert answer.headers["content-type"].startswith("application/link-format"), answer.text
    return [each for each in parse_links(answer.text.replace("\n", "")) if "memento" in each.rel.split()]


def steps(http: Any, url: str) -> str:
    """Return the content of a version."""
    answer = http.get(url, headers=NTRIPLES)
    assert answer.status_code == 200, answer.text
    (line,) = [each for each in answer.text.splitlines() if P in each]
    return line.split('"')[1]


@pytest.mark.slow
def test_versions_are_kept_bounded_durably_and_found_by_time(tmp_path: Path, serve: Callable[..., Any]) -> None:
    options = ("aircraft", "--data", str(tmp_path), "--versions", "3")
    crashing = serve(*options, process=True)
    for number in (*range(6), 5):
        put(crashing.http, number)
    crashing.process.kill()
    crashing.process.wait(60)
    http = serve(*options, "--port", str(httpx.URL(crashing.url).port)).http
    found = mementos(http)
    assert [steps(http, each.target) for each in found] == ["2", "3", "4", "5"], "three that were, and that of now"
    for each in found:
        memento = http.get(each.target, headers=NTRIPLES)
        assert memento.headers["memento-datetime"] == dict(each.attributes)["datetime"]
        assert memento.headers["allow"] == "GET, HEAD, OPTIONS"
        assert {"original", "timegate", "timemap"} <= {one.rel for one in parse_links(memento.headers["link"])}
    now = http.get(PLAN, headers=NTRIPLES)
    assert "accept-datetime" in now.headers["vary"].lower()
    assert "memento-datetime" not in now.headers
    assert f'<{now.url}?timemap>; rel="timemap"' in now.headers["link"]
    for datetime, step in (("Thu, 01 Jan 2099 00:00:00 GMT", "5"), ("Mon, 01 Jan 1990 00:00:00 GMT", "2")):
        gate = http.get(PLAN, headers={**NTRIPLES, "Accept-Datetime": datetime})
        assert (gate.status_code, steps(http, gate.headers["location"])) == (302, step)
    assert http.get(f"{PLAN}?at=1990-01-01T00:00:00Z", headers=JSON).status_code == 404
    assert http.get(f"{PLAN}?at=then", headers=JSON).status_code == 400
    text = http.get(f"{PLAN}?timemap", headers=NTRIPLES).text
    assert text.count("http://mementoweb.org/ns#mementoDatetime") == 4
    deleted(http)


def deleted(http: Any) -> None:
    """A deleted document remains in its past, which is deleted on request."""
    before = mementos(http)
    assert http.delete(PLAN).status_code == 204
    assert http.get(PLAN).status_code == 410
    assert [steps(http, each.target) for each in mementos(http)] == ["3", "4", "5"]
    assert http.get(f"{PLAN}?at=-0", headers=JSON).status_code in (400, 404)
    assert http.get(f"{PLAN}?at=2099-01-01T00:00:00Z", headers=JSON).status_code == 404, "it was there no more"
    assert parsedate_to_datetime(dict(before[-1].attributes)["datetime"])
    put(http, 7)
    assert [steps(http, each.target) for each in mementos(http)] == ["3", "4", "5", "7"]
    assert http.delete(f"{PLAN}?versions=true").status_code == 204
    assert http.get(f"{PLAN}?timemap").status_code == 410
    put(http, 8)
    assert [steps(http, each.target) for each in mementos(http)] == ["8"]


def test_without_the_option_there_are_no_versions(http: Any) -> None:
    put(http, 1, "/data/unversioned")
    put(http, 2, "/data/unversioned")
    answer = http.get("/data/unversioned", headers=NTRIPLES)
    assert '"2"' in answer.text
    assert "timemap" not in answer.headers.get("link", "")
    for query in ("at=2020-01-01T00:00:00Z", "timemap"):
        asked = http.get(f"/data/unversioned?{query}", headers={"Accept": "application/json"})
        assert asked.status_code == 404, "what is now is no answer to what was"
        assert "rosld serve --versions N" in asked.json()["detail"]
