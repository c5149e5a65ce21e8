"""Queries over many recordings: which are read, and aggregates from statistics equal those of all messages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime, timezone
from typing import Any

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.resources import past_messages
from tests import runs
from tests.server.auth.conftest import rule, token, tokens
from tests.server.conftest import served
from tests.server.sparql.past_at_random import PREFIXES, RUN_PREFIXES, of_runs

NAMES = ["first", "second", "third"]
SECONDS = 30.0
QUERIES = 40
READ = "OPTIONAL { ?m <urn:nothing> ?nothing }"
"""A pattern without effect that prevents an answer from statistics."""
RULES = (
    rule("anna", "read write control administer", "/**")
    + rule("guest", "read", "/**")
    + rule("guest", "read", "/bags/second/**", deny=True)
)
CHARGE = "</topics/battery_state> ros:past ?m . ?m ros:recordedIn ?bag ; battery:percentage ?charge"
LEAST = f"SELECT ?bag (MIN(?charge) AS ?least) {{ {CHARGE} }} GROUP BY ?bag"


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A server with three recordings, ten seconds apart: of ROS 1, and of ROS 2 in two formats."""
    data = tmp_path_factory.mktemp("data")
    (data / "bags").mkdir()
    for number, (name, suffix) in enumerate(zip(NAMES, (".bag", ".mcap", ".db3"), strict=True)):
        path = data / "bags" / f"{name}{suffix}"
        runs.write_run(path, seconds=SECONDS, seed=number, start_ns=runs.START_NS + number * 10_000_000_000)
    (data / "auth.toml").write_text(RULES + tokens("anna", "guest"))
    with served(adapter_for("aircraft", AdapterOptions()), data=data, auth=data / "auth.toml") as client:
        client.timeout = 60
        client.headers["Authorization"] = f"Bearer {token('anna')}"
        yield client


def ask(http: httpx.Client, query: str, agent: str = "anna") -> list[dict[str, str]]:
    """Return the rows of a result, with short names of recordings."""
    headers = {"Accept": "application/sparql-results+json", "Authorization": f"Bearer {token(agent)}"}
    text = query if "PREFIX" in query else f"{PREFIXES}{RUN_PREFIXES}{query}"
    answer = http.post("/sparql", content=text, headers={**headers, "Content-Type": "application/sparql-query"})
    assert answer.status_code == 200, (query, answer.text)
    bags = str(http.base_url) + "bags/"
    rows = answer.json()["results"]["bindings"]
    return [{name: each["value"].removeprefix(bags).rstrip("/") for name, each in row.items()} for row in rows]


def charges(number: int) -> list[float]:
    """Return the charges in a run, as float32 like in the message."""
    spoken = runs.spoken(2, SECONDS, number)
    return [float(each.message.percentage) for each in spoken if each.topic == "/battery_state"]


@pytest.mark.slow
def test_aggregates_of_each_recording_are_those_of_its_messages(many: httpx.Client) -> None:
    found = {row["bag"]: float(row["least"]) for row in ask(many, LEAST)}
    assert found == pytest.approx({name: min(charges(number)) for number, name in enumerate(NAMES)}, rel=1e-6)


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ('?bag ros:name "second" ; a ros:Bag .', ["second"]),
        ('?bag ros:name ?name FILTER(STRSTARTS(?name, "t"))', ["third"]),
        ("VALUES ?bag { </bags/first/> </bags/third/> }", ["first", "third"]),
        ("FILTER(?bag != </bags/first/>)", ["second", "third"]),
        ('?bag ros:name "no such"', []),
    ],
)
def test_patterns_select_recordings(many: httpx.Client, pattern: str, expected: list[str]) -> None:
    for query in (f"{{ {CHARGE} . {pattern} }}", f"{{ {CHARGE} . {pattern} {READ} }}"):
        rows = ask(many, f"SELECT ?bag (COUNT(*) AS ?n) {query} GROUP BY ?bag ORDER BY ?bag")
        assert rows == [{"bag": name, "n": "30"} for name in expected]


@pytest.mark.slow
def test_recordings_that_an_agent_may_not_read_are_absent(many: httpx.Client) -> None:
    ask(many, LEAST)
    assert sorted(row["bag"] for row in ask(many, LEAST, "guest")) == ["first", "third"]
    hidden = ask(many, f'SELECT ?m {{ {CHARGE} . ?bag ros:name "second" }}', "guest")
    assert hidden == ask(many, f'SELECT (COUNT(*) AS ?n) {{ {CHARGE} . ?bag ros:name "second" }} HAVING(?n)', "guest")


def test_comparisons_of_numbers_find_all_messages(many: httpx.Client) -> None:
    ask(many, LEAST)
    rows = ask(many, f"SELECT ?bag (COUNT(*) AS ?n) {{ {CHARGE} FILTER(?charge <= 0.7) }} GROUP BY ?bag")
    expected = {name: sum(each <= 0.7 for each in charges(number)) for number, name in enumerate(NAMES)}
    assert {row["bag"]: int(row["n"]) for row in rows} == {name: count for name, count in expected.items() if count}


def test_recordings_with_any_such_message_are_found(many: httpx.Client) -> None:
    for test in ("0.7 > ?charge", "?charge >= 0.89", "?charge > 2"):
        for selected in ("?bag", "?m"):
            query = f"SELECT DISTINCT {selected} {{ {CHARGE} FILTER({test}) %s }} ORDER BY {selected}"
            assert ask(many, query % "") == ask(many, query % READ), query


def test_what_is_read_counts_for_the_limit(many: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(past_messages, "MAX_PAST", 60)
    headers = {"Content-Type": "application/sparql-query"}
    ask(many, LEAST)  # reads no message
    refused = many.post("/sparql", content=f"{PREFIXES}{RUN_PREFIXES}SELECT * {{ {CHARGE} }}", headers=headers)
    assert refused.status_code == 503
    assert refused.json()["reason"] == "past"
    assert "/battery_state" in refused.json()["detail"]
    few = f"SELECT * {{ {CHARGE} FILTER(?charge < -1) }}"
    assert ask(many, few) == []
    for newest in ("DESC(?t)", "?t"):
        some = f"SELECT ?t {{ {CHARGE} ; ros:received ?t }} ORDER BY {newest} LIMIT 3"
        assert len(ask(many, some)) == 3, "the others are not read"


@pytest.mark.slow
def test_answers_from_statistics_are_those_from_messages(many: httpx.Client) -> None:
    start = datetime.fromtimestamp(runs.START_NS // 10**9, timezone.utc)
    nonempty = 0
    for seed in range(QUERIES):
        query = of_runs(seed, NAMES, start, SECONDS + 20)
        body, _, end = query.rpartition("}")
        found, expected = rows_of(ask(many, query)), rows_of(ask(many, f"{body} {READ} }}{end}"))
        assert len(found) == len(expected), (query, found, expected)
        for one, other in zip(found, expected, strict=True):
            assert one.keys() == other.keys(), (query, one, other)
            assert all(is_close(one[name], other[name]) for name in one), (query, one, other)
        nonempty += any(any(row.values()) for row in found)
    assert nonempty > QUERIES / 3


def rows_of(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: [row.get(name, "") for name in ("bag", "key", "topic")])


def is_close(one: str, other: str) -> bool:
    try:
        return math.isclose(float(one), float(other), rel_tol=1e-5, abs_tol=1e-9)
    except ValueError:
        return one == other
