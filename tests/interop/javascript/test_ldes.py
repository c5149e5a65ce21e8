"""An LDES client that others wrote: what it copies of a recording, and of a history, is what their messages say."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from typing import Any

import pytest
from pyoxigraph import BlankNode, NamedNode, RdfFormat, parse

from tests.adapters.recording.recorder import lines, write_rosbag1
from tests.interop.javascript.node import node
from tests.waiting import until

PATIENCE = 200.0
NTRIPLES = {"Accept": "application/n-triples"}
JSON = {"Accept": "application/json"}
COUNT = 230


@pytest.fixture(scope="module")
def recorded(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A rover with a history of frames, whose messages are nested, and a recording that it was sent."""
    server = start_server("rover", "--history", "/tf", "--history", "/odom")
    sent = write_rosbag1(tmp_path_factory.mktemp("sent") / "talk.bag", lines(count=COUNT))
    assert server.http.put("/bags/talk", content=sent.read_bytes()).status_code == 201
    return server


def copied(url: str, order: str = "none") -> list[dict[str, Any]]:
    """The members that the client finds, in the order in which it tells them."""
    done = subprocess.run(node("ldes.mjs", url, order), capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"id"')]


def said(text: str) -> list[str]:
    """Triples as the script prints them."""

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
    found = copied(f"{recorded.url}bags/talk/ldes", order)
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
    found = {one["id"]: one for one in copied(f"{recorded.url}bags/history/ldes")}
    assert set(before) <= found.keys(), "and those that have come since"
    for url in before[:: len(before) // 5]:
        assert sorted(found[url]["said"]) == said(recorded.http.get(url, headers=NTRIPLES).text)


def test_members_are_observations_where_that_profile_is_asked_for(recorded: Any) -> None:
    found = copied(f"{recorded.url}bags/talk/ldes?_profile=sosa", "ascending")
    assert [one["id"] for one in found] == [f"{recorded.url}bags/talk/messages/{number}" for number in range(COUNT)]
    sosa = "http://www.w3.org/ns/sosa/"
    for number, one in enumerate(found):
        assert f"<{one['id']}> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <{sosa}Observation>" in one["said"]
        value = json.dumps([str(number), "http://www.w3.org/2001/XMLSchema#string", ""], separators=(",", ":"))
        assert f"<{one['id']}> <{sosa}hasSimpleResult> {value}" in one["said"]
