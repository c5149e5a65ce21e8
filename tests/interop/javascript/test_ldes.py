"""A third-party LDES client: its copy of a recording or a history has the same statements as the messages."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import pytest
from pyoxigraph import BlankNode, NamedNode, RdfFormat, parse

from tests.adapters.recording.recorder import lines, write_rosbag1
from tests.interop.javascript.node import node
from tests.waiting import until

PATIENCE = 200.0
NTRIPLES = {"Accept": "application/n-triples"}
JSON = {"Accept": "application/json"}
COUNT = 230
SOSA = "http://www.w3.org/ns/sosa/"
TREE_NODE = "https://w3id.org/tree#node"


@pytest.fixture(scope="module")
def recorded(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A rover with a history of frames, whose messages are nested, and an uploaded recording."""
    server = start_server("rover", "--history", "/tf", "--history", "/odom")
    sent = write_rosbag1(tmp_path_factory.mktemp("sent") / "talk.bag", lines(count=COUNT))
    assert server.http.put("/bags/talk", content=sent.read_bytes()).status_code == 201
    return server


class Copy(NamedTuple):
    """The result of the client: members, in order, and the pages that it read."""

    members: list[dict[str, Any]]
    pages: set[str]


def copied(url: str, order: str = "none", prefer: str = "") -> Copy:
    """Return the members that the client finds in a stream, each once."""
    command = node("ldes.mjs", url, order, prefer)
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    lines = done.stdout.splitlines()
    members = [json.loads(line) for line in lines if line.startswith('{"id"')]
    (pages,) = (json.loads(line)["pages"] for line in lines if line.startswith('{"pages"'))
    assert len({one["id"] for one in members}) == len(members), "each member once"
    return Copy(members, set(pages))


def pages_of(http: Any, url: str, headers: Mapping[str, str] | None = None) -> set[str]:
    """Return the pages of a stream, linked by their relations."""
    found, unread = set[str](), [url]
    while unread:
        at = unread.pop()
        if at not in found:
            found.add(at)
            answer = http.get(at, headers={**NTRIPLES, **(headers or {})}).raise_for_status()
            nodes = (each for each in parse(answer.content, RdfFormat.N_TRIPLES) if each.predicate.value == TREE_NODE)
            unread += (each.object.value for each in nodes)
    return found


def said(text: str) -> list[str]:
    """Return triples as the script prints them."""

    def term(each: Any) -> str:
        if isinstance(each, BlankNode):
            return "_:b"
        if isinstance(each, NamedNode):
            return f"<{each.value}>"
        parts = [each.value, each.datatype.value, each.language or ""]
        return json.dumps(parts, ensure_ascii=False, separators=(",", ":"))

    found = parse(text.encode(), format=RdfFormat.N_TRIPLES)
    return sorted(f"{term(each.subject)} {term(each.predicate)} {term(each.object)}" for each in found)


@pytest.mark.parametrize("order", ["none", "ascending"])
def test_the_members_of_a_recording_are_its_messages_whole(recorded: Any, order: str) -> None:
    found, pages = copied(f"{recorded.url}bags/talk/ldes", order)
    assert pages == pages_of(recorded.http, f"{recorded.url}bags/talk/ldes")
    assert len(pages) > 2, "more than one page of messages"
    urls = [f"{recorded.url}bags/talk/messages/{number}" for number in range(COUNT)]
    ids = [one["id"] for one in found]
    assert (ids if order == "ascending" else sorted(ids)) == (urls if order == "ascending" else sorted(urls))
    assert {one["isVersionOf"] for one in found} == {f"{recorded.url}topics/chatter"}
    for one in found[:5]:
        assert sorted(one["said"]) == said(recorded.http.get(one["id"], headers=NTRIPLES).text)


def test_the_members_of_a_history_are_its_messages_whole(recorded: Any) -> None:
    listing = "/bags/history/messages/?limit=1000"
    until(lambda: len(recorded.http.get(listing, headers=JSON).json().get("messages", ())) > 250, "a past")
    before = [one["url"] for one in recorded.http.get(listing, headers=JSON).json()["messages"]]
    pages = pages_of(recorded.http, f"{recorded.url}bags/history/ldes")
    copy = copied(f"{recorded.url}bags/history/ldes")
    assert pages <= copy.pages, "and those that have been begun since"
    found = {one["id"]: one for one in copy.members}
    assert set(before) <= found.keys(), "and those that have come since"
    numbers = sorted(int(url.rpartition("/")[2]) for url in found)
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers))), "none is left out between two"
    for url in before[:: len(before) // 5]:
        assert sorted(found[url]["said"]) == said(recorded.http.get(url, headers=NTRIPLES).text)


@pytest.mark.parametrize(("query", "prefer"), [("?_profile=sosa", ""), ("", f'profile="{SOSA}"')])
def test_members_are_observations_where_that_profile_is_asked_for(recorded: Any, query: str, prefer: str) -> None:
    found, pages = copied(f"{recorded.url}bags/talk/ldes{query}", "ascending", prefer)
    assert pages == pages_of(recorded.http, f"{recorded.url}bags/talk/ldes{query}", {"Prefer": prefer})
    assert [one["id"] for one in found] == [f"{recorded.url}bags/talk/messages/{number}" for number in range(COUNT)]
    for number, one in enumerate(found):
        assert f"<{one['id']}> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <{SOSA}Observation>" in one["said"]
        value = json.dumps([str(number), "http://www.w3.org/2001/XMLSchema#string", ""], separators=(",", ":"))
        assert f"<{one['id']}> <{SOSA}hasSimpleResult> {value}" in one["said"]
