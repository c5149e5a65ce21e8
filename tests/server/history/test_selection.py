"""Messages by topic, time and number: pages of a history or a file equal a selection from all messages.

And all topics at one moment, and a part of a history played by another server.
"""

from __future__ import annotations

import csv
import io
import random
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import pyarrow as pa
import pytest
from pyarrow import parquet

from rosld.adapters.base import FOR_EVER, MessageFilter, RecordedMessage
from rosld.server.history import history
from rosld.server.history.chunk_index import ChunkRow
from rosld.server.history.history import select_messages
from rosld.server.history.history_writer import HistoryWriter
from tests.adapters.recording.recorder import Line, lines, write_rosbag1
from tests.server.history.test_recordings import ROS, SPEED
from tests.server.history.test_segments import LIMITS, START, open_writer, sample
from tests.waiting import until

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
TOPICS = ("/a", "/b", "/c", "/seldom")
WALK_START = "2023-11-14T22:13:20"
WALK = [
    Line(0.0, "/name", "a walk", "/walker", latched=True),
    Line(0.1, "/left", "1"),
    Line(0.2, "/right", "2"),
    Line(0.3, "/left", "3"),
    Line(0.4, "/left", "4", "/other"),
    Line(0.5, "/right", "5"),
]


class _Said(NamedTuple):
    number: int
    topic: str
    time_ns: int


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[HistoryWriter, list[_Said]]]:
    """Write a history of three segments, the last chunks still in memory, whose times are not quite in order."""
    at_random = random.Random(19)
    writer = open_writer(tmp_path_factory.mktemp("history"), LIMITS)
    said: list[_Said] = []
    for part in range(3):
        for _ in range(300):
            topic = at_random.choices(TOPICS, (50, 30, 19, 1))[0]
            one = sample(writer.next)
            one = one._replace(received_ns=one.received_ns + at_random.randrange(-30_000_000, 30_000_000))
            said.append(_Said(writer.next, topic, one.received_ns))
            writer.add(topic, one)
            if at_random.random() < 0.02:
                writer.write_due(time.monotonic() + at_random.choice((0, 2)))
        if part < 2:
            writer.close()
    yield writer, said
    writer.close()
    writer.segments.close()


def everything(writer: HistoryWriter, wanted: MessageFilter, limit: int) -> list[RecordedMessage]:
    """Return all pages together."""
    found: list[RecordedMessage] = []
    start: int | None = wanted.start
    while start is not None:
        page = select_messages(
            writer, MessageFilter(wanted.topics, wanted.from_ns, wanted.to_ns, start, wanted.end), limit
        )
        assert len(page.messages) <= limit
        assert page.next is None or page.next > page.messages[-1].index
        found += page.messages
        start = page.next
    return found


def test_pages_of_the_history_are_what_a_look_at_every_message_gives(
    written: tuple[HistoryWriter, list[_Said]],
) -> None:
    for topics, limit in ((None, 1000), ({"/a"}, 7), ({"/seldom", "/b"}, 7), ({"/none"}, 1000)):
        pages_are_complete(written, topics, limit)


def pages_are_complete(written: tuple[HistoryWriter, list[_Said]], topics: set[str] | None, limit: int) -> None:
    writer, said = written
    end = START + 900 * 10_000_000
    spans = [(0, FOR_EVER), (START + 2_500_000_000, START + 3_500_000_000), (end - 2_000_000_000, FOR_EVER), (5, 6)]
    for since, until_ns in spans:
        for start, beyond in ((0, FOR_EVER), (299, 302), (150, 700)):
            wanted = MessageFilter(None if topics is None else frozenset(topics), since, until_ns, start, beyond)
            expected = [
                one
                for one in said
                if (topics is None or one.topic in topics)
                and since <= one.time_ns <= until_ns
                and start <= one.number < beyond
            ]
            found = everything(writer, wanted, limit)
            assert [(each.index, each.topic, each.sample.received_ns) for each in found] == expected
            assert all(each.sample.data == sample(each.index).data for each in found)


def test_a_page_reads_only_the_chunks_that_its_messages_are_in(
    written: tuple[HistoryWriter, list[_Said]], monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, _ = written
    read: list[ChunkRow] = []
    messages_of = writer.segments.messages_of

    def counting(row: ChunkRow) -> Any:
        read.append(row)
        return messages_of(row)

    monkeypatch.setattr(writer.segments, "messages_of", counting)
    page = history.select_messages(writer, MessageFilter(frozenset({"/a"})), 10)
    assert len(page.messages) == 10
    needed = {one.index for one in page.messages}
    assert {row.topic for row in read} == {"/a"}
    assert all(any(row.first <= each <= row.last for each in needed) for row in read)


@pytest.fixture(scope="module")
def talk(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An aircraft with uploaded recordings: of 20 lines, one every 10 ms, and of three topics."""
    folder = tmp_path_factory.mktemp("talk")
    server = start_server("aircraft", "--history", "/aircraft/*", "--data", str(folder / "data"))
    server.data = folder / "data"
    for name, said in (("talk", lines(count=20)), ("walk", WALK)):
        sent = write_rosbag1(folder / f"{name}.bag", said)
        assert server.http.put(f"/bags/{name}", content=sent.read_bytes()).status_code == 201
    return server


def pages(http: Any, path: str) -> list[Any]:
    """Return the messages of all pages, in JSON."""
    found: list[Any] = []
    while path:
        answer = http.get(path, headers=JSON)
        assert answer.status_code == 200, answer.text
        assert answer.links.get("next", {}).get("url") == answer.json()["next"]
        found += answer.json()["messages"]
        path = answer.json()["next"]
    return found


@pytest.mark.slow
def test_a_recording_is_listed_by_topic_and_time_in_pages_in_every_representation(talk: Any) -> None:
    http, base = talk.http, "/bags/talk/messages/"
    every = pages(http, f"{base}?limit=7")
    assert [one["index"] for one in every] == list(range(20))
    assert [one["message"] for one in every] == [{"data": str(number)} for number in range(20)]
    assert [http.get(one["url"], headers=JSON).json() for one in every[:3]] == [one["message"] for one in every[:3]]
    topic = every[0]["topic"]
    since, until_time = every[4]["time"], every[9]["time"]
    some = pages(http, f"{base}?topic={topic}&from={since}&to={until_time}&limit=4")
    assert [one["index"] for one in some] == list(range(4, 10))
    rdf = http.get(f"{base}?from={since}&to={until_time}", headers=NTRIPLES)
    alone: Sequence[str] = [line for one in some for line in http.get(one["url"], headers=NTRIPLES).text.splitlines()]
    assert set(alone) <= set(rdf.text.splitlines()), "each as it stands at its own URL"
    html = http.get(f"{base}?topic={topic}&limit=4", headers={"Accept": "text/html"})
    assert html.status_code == 200
    assert '/bags/talk/messages/3"' in html.text, html.text
    assert "start=4" in html.text, "the next page is linked"


@pytest.mark.slow
def test_the_history_is_listed_by_topic_while_it_is_written(talk: Any) -> None:
    http, topic = talk.http, "/aircraft/engine/speed"
    path = f"/bags/history/messages/?topic={topic}&limit=1000"
    until(lambda: len(http.get(path, headers=JSON).json().get("messages", ())) > 30, "a past")
    found = pages(http, f"/bags/history/messages/?topic={topic}&limit=9&from=-3600&to=-0.5")
    assert {one["topic"] for one in found} == {topic}
    assert [one["index"] for one in found] == sorted({one["index"] for one in found})
    assert [one["time"] for one in found] == sorted(one["time"] for one in found)
    rows = pages(http, "/bags/history/messages/?topic=/aircraft/*&limit=50&to=-0.5")
    assert [one for one in rows if one["topic"] == topic] == found[: len(rows)] or len(rows) > len(found)


@pytest.mark.slow
def test_a_parameter_that_makes_no_sense_is_refused_and_says_why(talk: Any) -> None:
    queries = ("topic=odom", "topic=", "topic=/none", "from=yesterday", "from=-1&to=-2", "start=-1", "start=x",
               "start=99999999999999999999", "limit=0", "limit=1001")  # fmt: skip
    for query in queries:
        answer = talk.http.get(f"/bags/talk/messages/?{query}", headers=JSON)
        assert answer.status_code == (404 if query == "topic=/none" else 400), query
        assert len(answer.json()["detail"]) > 20


@pytest.mark.slow
def test_a_topic_of_a_recording_is_a_table(talk: Any) -> None:
    http, base = talk.http, "/bags/talk/messages/"
    one = pages(http, f"{base}?limit=20")
    topic = one[0]["topic"]
    answer = http.get(f"{base}?topic={topic}&from={one[4]['time']}&limit=9", headers={"Accept": "text/csv"})
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    head, *rows = csv.reader(io.StringIO(answer.text))
    assert head == ["received", "index", "publisher", "data"]
    assert [(int(index), data) for _, index, _, data in rows] == [(number, str(number)) for number in range(4, 13)]
    for format in ("parquet", "arrow"):
        path = f"{base}?topic={topic}&format={format}"
        answer = http.get(path)
        read = parquet.read_table if format == "parquet" else lambda file: pa.ipc.open_stream(file).read_all()
        assert read(io.BytesIO(answer.content))["data"].to_pylist() == [str(number) for number in range(20)]
        assert answer.headers["content-type"] == f"application/vnd.apache.{format}{'.stream' * (format == 'arrow')}"
        assert http.get(path, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
        moving = http.get(f"{path}&from=-1000000000").headers["etag"]
        assert http.get(f"{path}&from=-1000000000").headers["etag"] != moving
        assert http.head(path).headers["etag"] == answer.headers["etag"]
    answer = http.get("/bags/history/messages/?format=csv")
    assert (answer.status_code, "name it" in answer.text) == (400, True), answer.text
    until(lambda: "/aircraft/engine/speed" in http.get("/bags/history/messages/?start=0", headers=JSON).text, "a past")
    history = http.get("/bags/history/messages/?topic=/aircraft/engine/speed&format=parquet&to=-0.1")
    assert parquet.read_table(io.BytesIO(history.content)).schema.metadata[b"topic"] == b"/aircraft/engine/speed"


def texts(http: Any, path: str) -> dict[str, str]:
    """Return the texts of the topics, by name."""
    answer = http.get(path, headers=JSON)
    assert answer.status_code == 200, answer.text
    return {one["topic"]: one["message"]["data"] for one in answer.json()["messages"]}


@pytest.mark.slow
def test_all_topics_of_a_recording_are_as_they_were_at_a_moment(talk: Any) -> None:
    name, expected = {"/name": "a walk"}, dict[str, dict[str, str]]()
    for second, left, right in (
        (".05", "", ""),
        (".1", "1", ""),
        (".35", "3", "2"),
        (".45", "4", "2"),
        (".9", "4", "5"),
    ):
        expected[second] = name | ({"/left": left} if left else {}) | ({"/right": right} if right else {})
    assert {each: texts(talk.http, f"/bags/walk/at?time={WALK_START}{each}Z") for each in expected} == expected


@pytest.mark.slow
def test_a_moment_is_the_same_in_every_representation_and_the_end_without_a_time(talk: Any) -> None:
    http = talk.http
    assert texts(http, "/bags/walk/at") == {"/name": "a walk", "/left": "4", "/right": "5"}
    assert texts(http, "/bags/walk/at?topic=/l*") == {"/left": "4"}
    text = http.get(f"/bags/walk/at?time={WALK_START}.35Z", headers=NTRIPLES).text
    assert text.count(f"<{ROS}newestRecord>") == 3
    assert set(http.get("/bags/walk/messages/3", headers=NTRIPLES).text.splitlines()) <= set(text.splitlines())
    page = http.get(f"/bags/walk/at?time={WALK_START}.35Z", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert '/bags/walk/messages/3"' in page.text
    assert texts(http, "/bags/walk/at?time=1990-01-01T00:00:00Z") == {}
    for query, status in (("time=then", 400), ("topic=left", 400), ("topic=/none", 404)):
        refused = http.get(f"/bags/walk/at?{query}", headers=JSON)
        assert (refused.status_code, len(refused.json()["detail"]) > 20) == (status, True), query


@pytest.mark.slow
def test_the_history_of_a_running_robot_has_moments_too(talk: Any) -> None:
    http = talk.http

    def moment() -> dict[str, Any]:
        found: dict[str, Any] = http.get("/bags/history/at?time=-0.2", headers=JSON).json()
        return found if SPEED in {one["topic"] for one in found.get("messages", ())} else {}

    until(moment, "the speed of a moment ago")
    answer = moment()
    for one in answer["messages"]:
        assert one["time"][:26].rstrip("Z") <= answer["time"][:26].rstrip("Z")
    speed = next(one for one in answer["messages"] if one["topic"] == SPEED)
    assert http.get(speed["url"], headers=JSON).json() == speed["message"]


@pytest.mark.slow
def test_a_part_of_a_history_that_was_kept_is_played_by_another_server(talk: Any, serve: Callable[..., Any]) -> None:
    http = talk.http
    path = f"/bags/history/messages/?topic={SPEED}&limit=1000"
    until(lambda: len(http.get(path, headers=JSON).json().get("messages", ())) > 10, "a past")
    assert talk.stop() == 0
    other = serve(f"{talk.data / 'history'}?from=0&rate=1").http
    found = other.get(path, headers=JSON).json()["messages"]
    assert len(found) > 10
    assert other.get(f"/topics{SPEED}", headers=JSON).status_code == 200
