"""The history over HTTP: robots of every kind recorded, in spite of kills and a full disk."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rosld.server.cli.failure import Failure
from tests.adapters.recording.recorder import lines, write_rosbag1
from tests.server.disks.server import Server, server_on
from tests.server.disks.test_full_disk import disk
from tests.server.history.mcap_files import decode, finished, profile, read
from tests.server.sparql.processes import until_ready
from tests.waiting import until

pytestmark = pytest.mark.slow

__all__ = ["disk"]
"""A fixture of other tests."""
JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
SPEED = "/aircraft/engine/speed"
LOST_NS = 2_000_000_000


def number(http: Any, term: str) -> int:
    """Return a number that the history reports."""
    text = http.get("/bags/history/", headers=NTRIPLES).text
    subject = f"<{http.base_url}bags/history/> <https://w3id.org/rosld#{term}> "
    return next(int(line.split('"')[1]) for line in text.splitlines() if line.startswith(subject))


def segments(folder: Path) -> list[Path]:
    return sorted((folder / "history").glob("*.mcap"))


def test_a_rover_is_recorded_as_others_read_it(serve: Callable[..., Any], tmp_path: Path) -> None:
    recorded = [word for topic in ("/odom", "/scan", "/map") for word in ("--history", topic)]
    server = serve("rover", "--data", str(tmp_path), *recorded)
    until(lambda: number(server.http, "count") >= 60, "sixty messages")
    assert "header" in server.http.get("/bags/history/messages/0", headers=JSON).json()
    described = server.http.get("/bags/history/", headers={"Accept": "text/turtle"}).text
    for topic in ("/odom", "/scan", "/map"):
        assert f'ros:name "{topic}"' in described
    assert "/tf" not in described
    assert server.stop() == 0
    (path,) = segments(tmp_path)
    assert profile(path) == "ros2"
    messages, decoded = read(path), decode(path)
    assert {one.topic for one in messages} == {"/odom", "/scan", "/map"}
    assert len(decoded) == len(messages) >= 60
    odometry: list[Any] = [message for topic, message in decoded if topic == "/odom"]
    assert all(message.header.frame_id == "odom" for message in odometry)


def test_the_history_in_memory_is_bounded_and_what_was_removed_is_gone(serve: Callable[..., Any]) -> None:
    served = serve("aircraft", "--history", "*", "--history-size", "4000")
    first = "/bags/history/messages/0"
    until(lambda: served.http.get(first, headers=JSON).status_code == 410, "the first message to be removed")
    [left] = served.http.get("/bags/history/messages/?limit=1", headers=JSON).json()["messages"]
    assert left["index"] > 0
    assert left["message"] == {"data": 0.0}
    assert served.http.get("/bags/history/messages/999999999").status_code == 404


def test_a_query_reads_messages_of_the_history_it_names_once_they_are_there(serve: Callable[..., Any]) -> None:
    served = until_ready(serve("aircraft", "--history", SPEED))
    graph = f"{served.url}bags/history/messages/{number(served.http, 'count') + 20}"
    query = f"""PREFIX ros: <https://w3id.org/rosld#>
    SELECT ?topic {{ GRAPH <{graph}> {{ ?r ros:onTopic ?topic ; ros:recordedAt ?at }} }}"""

    def topics() -> list[str]:
        answer = served.http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
        assert answer.status_code == 200, answer.text
        return answer.text.split()[1:]

    assert topics() == []
    assert until(topics, "the message") == [f"{served.url}topics{SPEED}"]
    named = f"SELECT ?n {{ <{served.url}bags/history/> <https://w3id.org/rosld#count> ?n }}"

    def counted() -> int:
        answer = served.http.get("/sparql", params={"query": named}, headers={"Accept": "text/csv"})
        return int(answer.text.split()[1])

    until(lambda: counted() >= 5, "the number of messages")


@pytest.mark.timeout(300)
def test_a_kill_loses_no_more_than_two_seconds_and_leaves_files_that_are_read(tmp_path: Path) -> None:
    with server_on(tmp_path / "data", tmp_path / "log") as server:
        for run in range(2):
            if run == 0:
                server.start("--history", SPEED)
            began = time.time_ns()
            before = number(server.http, "count")
            until(lambda before=before: number(server.http, "count") > before + 20, "messages")
            at = number(server.http, "count") - 1
            last = server.http.get(f"/bags/history/messages/{at}", headers=NTRIPLES)
            assert last.status_code == 200
            killed = time.time_ns()
            server.kill()
            server.start("--history", SPEED)
            found = [one for path in finished(tmp_path / "data" / "history") for one in read(path)]
            newest = max((one.time_ns for one in found), default=0)
            assert killed - max(newest, began) < LOST_NS
            assert sorted(one.sequence for one in found) == list(range(len(found)))
            assert server.http.get("/bags/history/messages/0", headers=JSON).json() == {"data": 0.0}
        assert server.stop() == 0


@pytest.fixture
def recording(disk: Path, tmp_path: Path) -> Iterator[Server]:
    """The aircraft recorded on a small disk."""
    with server_on(disk / "data", tmp_path / "log") as served:
        served.start("--history", SPEED)
        yield served


def test_a_full_disk_stops_the_history_alone_says_so_and_ends_by_itself(recording: Server, disk: Path) -> None:
    http = recording.http
    until(lambda: number(http, "count") >= 40, "messages that are on the disk")
    filler = disk / "filler"
    free = subprocess.run(["stat", "-f", "-c", "%a %S", disk], capture_output=True, text=True, check=True).stdout
    blocks, size = map(int, free.split())
    filler.write_bytes(bytes(blocks * size - 600_000))
    until(lambda: "recordingProblem" in http.get("/bags/history/", headers=NTRIPLES).text, "the problem")
    for path, words in (("/", NTRIPLES), ("/status", NTRIPLES), ("/status", JSON), ("/", {"Accept": "text/html"})):
        assert "The history is not recorded" in http.get(path, headers=words).text, path
    query = "SELECT ?p { ?s <https://w3id.org/rosld#recordingProblem> ?p }"
    found = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text
    assert "No space left" in found
    assert http.get("/bags/history/messages/0", headers=JSON).json() == {"data": 0.0}
    put = http.put("/data/note", content="<> a <#N> .", headers={"Content-Type": "text/turtle"})
    assert put.status_code == 201
    until(lambda: "#dropped" in http.get("/bags/history/", headers=NTRIPLES).text, "what was dropped")
    filler.unlink()
    until(lambda: "recordingProblem" not in http.get("/bags/history/", headers=NTRIPLES).text, "the end of it")
    count = number(http, "count")
    until(lambda: number(http, "count") > count, "more messages")
    assert recording.stop() == 0
    assert all(read(path) for path in segments(disk / "data"))


def test_a_recording_has_no_history(serve: Callable[..., Any], tmp_path: Path) -> None:
    path = write_rosbag1(tmp_path / "talk.bag", lines())
    with pytest.raises(Failure, match="not possible when serving a recording, whose messages are already stored"):
        serve(str(path), "--history", "*")
