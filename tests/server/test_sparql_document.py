"""`docs/reference/sparql.md` is true: each query and update in it is run, and has the printed results."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from tests.waiting import once_started

TEXT = (Path(__file__).parents[2] / "docs" / "reference" / "sparql.md").read_text("utf-8")
BLOCK = re.compile(r"(?:\[//\]: # \((?P<on>aircraft[^)]*)\)\n)?```(?P<kind>\w+)\n(?P<text>.*?)```\n", re.DOTALL)
PRINTED = "http://127.0.0.1:8080/"


class Example(NamedTuple):
    """A query or an update; how it is run on the aircraft (None if it is about another robot); its printed results."""

    text: str
    on: tuple[str, ...] | None
    kind: str
    printed: str


def examples() -> Iterator[Example]:
    """Yield the examples of the document, in order."""
    blocks = list(BLOCK.finditer(TEXT))
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        if block["kind"] == "sparql":
            on = None if block["on"] is None else tuple(block["on"].split()[1:])
            answered = after is not None and after["kind"] in ("csv", "json")
            yield Example(block["text"], on, after["kind"] if answered else "", after["text"] if answered else "")


def is_update(example: Example) -> bool:
    return re.search(r"^(SELECT|ASK|CONSTRUCT|DESCRIBE)", example.text, re.MULTILINE) is None


def rows(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text)))


@pytest.mark.slow
def test_every_example_is_answered_as_printed(plane: httpx.Client) -> None:
    assert re.findall(r"^\*\*(\d+)\. ", TEXT, re.MULTILINE) == [str(number) for number in range(1, 10)]
    found = list(examples())
    assert {one.on[0] for one in found if one.on} == {"200", "204", "403", "422"}, "updates of every outcome"
    for example in found:
        if is_update(example):
            update(plane, example)
        else:
            query(plane, example)

    def plain(path: str) -> Any:
        return plane.get(path, headers={"Accept": "application/json"}).json()

    assert plain("/resources/aircraft/power") == "on"
    assert plain("/parameters/cabin/height") == 15
    assert plain("/topics/cockpit/display") == {"data": "climb"}
    assert plane.get("/data/log/1").status_code == 404
    named = {"graph": str(plane.base_url.join("/topics/cockpit/display"))}
    answer = plane.get("/graphs", params=named, headers={"Accept": "application/json"})
    assert answer.json() == {"data": "climb"}, "the graph store answers as the resource does"


def query(http: httpx.Client, example: Example) -> None:
    """Check that the columns are those printed; on the aircraft also the rows, except numbers that change."""
    answer = http.get("/sparql", params={"query": example.text}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    printed = [row for row in rows(example.printed) if row != ["..."]]
    found = rows(answer.text.replace(str(http.base_url), PRINTED))
    assert found[0] == printed[0]
    assert all(len(row) == len(printed[0]) for row in printed)
    if example.on is not None:
        assert [[each for each in row if ":" in each] for row in found] == [
            [each for each in row if ":" in each] for row in printed
        ]


def update(http: httpx.Client, example: Example) -> None:
    """Check that the status is the printed one, and that the JSON has its members and texts."""
    if example.on is None:
        answer = http.post("/sparql", content=example.text, headers=_UPDATE, params={"dry-run": "true"})
        assert answer.status_code in (200, 422), answer.text
        return
    status, *flags = example.on
    answer = http.post("/sparql", content=example.text, headers=_UPDATE, params=dict.fromkeys(flags, "true"))
    assert answer.status_code == int(status), answer.text
    if example.printed:
        told = json.loads(answer.text.replace(str(http.base_url), PRINTED))
        assert told == json.loads(example.printed)
    if flags:
        update(http, example._replace(on=("204",), printed=""))


_UPDATE = {"Content-Type": "application/sparql-update"}


def test_stored_queries_take_parameters_and_refuse_bad_ones(plane: httpx.Client) -> None:
    asked = {"least": "1", "format": "json"}
    assert plane.get("/queries/fastest-topics", params=asked).json()["head"]["vars"] == ["topic", "name", "rate"]
    refused = plane.get("/queries/fastest-topics", params={"least": "fast", "format": "csv"})
    assert refused.status_code == 400
    words = re.sub(r"\s+", " ", TEXT)
    assert refused.json()["detail"] in words


def test_a_query_that_exceeds_its_timeout_says_so(plane: httpx.Client) -> None:
    heavy = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i }"
    assert heavy in TEXT
    answer = once_started(lambda: plane.post("/sparql", params={"timeout": "0.2"}, data={"query": heavy}))
    assert (answer.status_code, answer.json()["reason"]) == (503, "time")
    assert answer.json()["detail"] in TEXT
