"""curl, as typed by people, with HTTP/1.1 and with `--http2`, which on plain HTTP requests an upgrade to h2c."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

TURTLE = ("-H", "Content-Type: text/turtle")
PATIENCE = 30.0
CODE = ("-o", "/dev/null", "-w", "%{http_code}")


@pytest.fixture(params=[(), ("--http2",)], ids=["http1.1", "http2"])
def version(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """Options that select the version of HTTP."""
    chosen: tuple[str, ...] = request.param
    return chosen


def test_a_file_is_put_and_fetched(
    curl: Callable[..., str], folder: str, version: tuple[str, ...], tmp_path: Path
) -> None:
    file = tmp_path / "note.txt"
    file.write_text("ä" * 1000)
    kind = ("-H", "Content-Type: text/plain; charset=utf-8")
    assert curl(*version, *CODE, *kind, "-T", str(file), f"{folder}note.txt") == "201"
    assert curl(*version, f"{folder}note.txt") == file.read_text()
    assert curl(*version, "-r", "0-3", f"{folder}note.txt") == "ää"


def test_a_chunked_body_is_put_whole(curl: Callable[..., str], folder: str, version: tuple[str, ...]) -> None:
    turtle = "".join(f"<urn:s> <urn:p> {number} .\n" for number in range(2000))
    assert curl(*version, *CODE, *TURTLE, "-T", "-", f"{folder}many", given=turtle) == "201"
    assert curl(*version, "-H", "Accept: application/n-triples", f"{folder}many").count("<urn:p>") == 2000


def test_a_body_that_waits_for_continue_is_put_whole(
    curl: Callable[..., str], folder: str, version: tuple[str, ...]
) -> None:
    body = "x" * 2_000_000
    kind = ("-H", "Content-Type: text/plain", "-H", "Expect: 100-continue")
    assert curl(*version, *CODE, *kind, "-T", "-", f"{folder}large", given=body) == "201"
    assert curl(*version, f"{folder}large") == body


def test_a_query_and_an_update_are_posted_as_forms(
    curl: Callable[..., str], server: Any, folder: str, version: tuple[str, ...]
) -> None:
    update = f"update=INSERT DATA {{ GRAPH <{folder}g> {{ <urn:s> <urn:p> 'a+b&c' }} }}"
    assert curl(*version, *CODE, "--data-urlencode", update, f"{server.url}sparql") == "204"
    query = f"query=SELECT ?o {{ GRAPH <{folder}g> {{ <urn:s> <urn:p> ?o }} }}"
    asked = ("-H", "Accept: text/csv", "--data-urlencode", query, f"{server.url}sparql")
    assert curl(*version, *asked).split() == ["o", "a+b&c"]
    assert curl(*version, "-G", *asked).split() == ["o", "a+b&c"]


def test_what_follows_in_one_connection_is_done_in_turn(
    curl: Callable[..., str], folder: str, version: tuple[str, ...]
) -> None:
    def put(value: int) -> tuple[str, ...]:
        return (*version, *CODE, *TURTLE, "-X", "PUT", "-d", f"<> <urn:p> {value} .", f"{folder}x", "--next", "-sS")

    read = (*version, "-w", "%{num_connects}", "-H", "Accept: application/n-triples", f"{folder}x")
    told = curl(*put(1), *put(2), *read)
    assert told.startswith("201204")
    assert '"2"' in told
    assert told.endswith("0"), "a new connection was needed"


def test_a_service_is_called_and_a_topic_published(
    curl: Callable[..., str], server: Any, version: tuple[str, ...]
) -> None:
    kind = ("-H", "Content-Type: application/json", "-H", "Accept: application/json")
    call = (*kind, "-d", "{}", f"{server.url}services/aircraft/get_power")
    assert '"data"' in curl(*version, *call)
    publish = (*CODE, *kind, "-X", "PUT", "-d", '{"data": "hello"}', f"{server.url}topics/cockpit/display")
    assert curl(*version, *publish) == "204"


def test_what_is_known_already_is_not_sent_again(
    curl: Callable[..., str], server: Any, version: tuple[str, ...], tmp_path: Path
) -> None:
    tag, url = str(tmp_path / "tag"), f"{server.url}ontology"
    assert curl(*version, *CODE, "--etag-save", tag, url) == "200"
    assert curl(*version, *CODE, "--etag-compare", tag, url) == "304"


def test_many_requests_side_by_side_are_each_answered(
    curl: Callable[..., str], folder: str, version: tuple[str, ...]
) -> None:
    names = "{" + ",".join(f"n{number}" for number in range(20)) + "}"
    many = [*version, "--parallel", *TURTLE, "-X", "PUT", "-d", "<> <urn:p> 1 .", "-w", "%{http_code}\n"]
    told = subprocess.run(
        ["curl", "-sS", *many, "-o", "/dev/null", f"{folder}{names}"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    assert sorted(told.stdout.split()) == ["201"] * 20
