"""The past in queries: over what is read as over all that is recorded, lifted message by message as GET says it."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import NamedTuple

import pytest
from pyoxigraph import BlankNode, QueryBoolean, QuerySolutions, RdfFormat, Store
from rosbags.rosbag2 import StoragePlugin, Writer

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.vocab import PREFIXES, ros
from rosld.server.auth.permissions import ALLOW_ALL
from rosld.server.http.problem import Problem
from rosld.server.resources.past_messages import RecordedPast
from rosld.server.robot.session import Session
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.routing.services import Services
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.intervals import Interval
from rosld.server.sparql.past import PastEnd
from tests.server.sparql import recorded
from tests.server.sparql.past_at_random import PastMaker

QUERIES = 600
FIRST_ROWS = 200
MAX_ROWS = 3000
TURNS = 8
SECONDS = 4.0
_SECOND = 1_000_000_000


class Recorded(NamedTuple):
    """A robot that serves a recording, all that is said of its messages, and from when on they are."""

    services: Services
    loop: asyncio.AbstractEventLoop
    described: str
    everything: str
    start_ns: int


def write(folder: Path, start_ns: int) -> Path:
    """A recording of the topics of `recorded.py`, each some times, at times of its own."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for number, (topic, message) in enumerate(recorded.messages()):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=recorded.STORE)
            for turn in range(TURNS):
                if topic == "/cmd_vel":
                    message.linear.x = float(turn)
                at = start_ns + int(turn * SECONDS / TURNS * _SECOND) + number * 7_000_001
                writer.write(connection, at, recorded.STORE.serialize_cdr(message, message.__msgtype__))
    return folder


@pytest.fixture(scope="module")
def past(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorded]:
    """A recording of a minute ago, served within this process."""
    start_ns = time.time_ns() - 60 * _SECOND
    source = str(write(tmp_path_factory.mktemp("past") / "run", start_ns))
    loop = asyncio.new_event_loop()
    services = Services(adapter_for(source, AdapterOptions()), Settings())
    loop.run_until_complete(services.start())
    texts = described(services.session), loop.run_until_complete(everything(services))
    yield Recorded(services, loop, *texts, start_ns)
    loop.run_until_complete(services.stop())
    loop.close()


def described(session: Session) -> str:
    """What is said of topics beside their messages."""
    space = session.space
    lines = []
    for topic in session.graph.topics.values():
        node = f"<{space.topic(topic.name)}>"
        lines += [f'{node} {ros.name} "{topic.name}" .', f"{node} a {ros.Topic} ."]
        lines += [f"{node} {ros.hasMessageType} <{space.class_of(ref.name)}> ." for ref in topic.types]
    return "\n".join(lines)


async def everything(services: Services) -> str:
    """All messages of the recording as their own URLs say them, and the links from topics and to the recording."""
    factory, space = ResourceFactory(services), services.session.space
    (recording,) = services.session.adapter.recordings.values()
    texts = []
    for index in range(recording.count):
        document = (await factory.bag_message(recording, index).state()).document
        texts.append(serialize(document, Syntax.N_TRIPLES).decode())
        topic, message = space.topic(recording.message(index).topic), f"<{document.url}#message>"
        texts.append(f"<{topic}> {ros.past} {message} .\n")
        texts.append(f"{message} {ros.recordedIn} <{space.bag(recording.name)}> .\n")
    return "".join(texts)


def store_of(*texts: str) -> Store:
    store = Store()
    for text in texts:
        store.load(text, RdfFormat.TURTLE)
    return store


def answers(store: Store, query: str, base: str) -> list[str]:
    found = store.query(query, base_iri=base, prefixes=dict(PREFIXES))
    if isinstance(found, QueryBoolean):
        return [str(bool(found))]
    rows: list[str] = []
    for row in found:
        terms = row if isinstance(found, QuerySolutions) else row.triple if hasattr(row, "triple") else row
        rows.append(" ".join("_" if each is not None and str(each).startswith("_:") else str(each) for each in terms))
        if len(rows) > MAX_ROWS:
            raise OverflowError
    return rows if "ORDER BY" in query else sorted(rows)


def read(past: Recorded, query: str, now_ns: int) -> str:
    """What is read of the past for a query."""
    return read_end(past, query, now_ns, None)[0]


def read_end(past: Recorded, query: str, now_ns: int, most: int | None) -> tuple[str, PastEnd | None]:
    """What is read of the past for a query, of about so many messages; at which end, None where that is all."""
    space = past.services.session.space
    asked = Analyser(space.base, space.types).analyse_once(query).past
    assert asked is not None
    moments = Interval(now_ns, now_ns)
    until = time.monotonic() + 60
    found = past.loop.run_until_complete(
        RecordedPast(past.services.session, past.services.recordings).read(asked, (), ALLOW_ALL, moments, until, most)
    )
    return found.text.decode(), None if found.is_whole else asked.end


def test_a_query_answers_over_what_it_reads_as_over_all_that_is_recorded(past: Recorded) -> None:
    base = past.services.session.space.base
    now_ns = time.time_ns()
    now = datetime.fromtimestamp(now_ns // 1000 / 1e6, timezone.utc)
    now_ns = int(now.timestamp() * 1e6) * 1000
    start = datetime.fromtimestamp(past.start_ns // _SECOND, timezone.utc)
    maker = PastMaker(base, start, SECONDS, now)
    full = store_of(past.described, past.everything)
    refused = narrowed = found = 0
    for seed in range(QUERIES):
        query = maker.query(seed)
        try:
            text = read(past, query, now_ns)
            spelt = query.replace("NOW()", f'"{now.isoformat()}"^^xsd:dateTime')
            expected = answers(full, spelt, base)
        except (SyntaxError, Problem, OverflowError):
            refused += 1
            continue
        assert answers(store_of(past.described, text), spelt, base) == expected, f"seed {seed}: {query}"
        narrowed += text.count(f"{ros.past}") < TURNS * len(recorded.messages())
        found += expected not in ([], ["False"])
    assert refused < QUERIES / 5
    assert narrowed > QUERIES / 4, "hardly anything is narrowed"
    assert found > QUERIES / 4, "hardly anything is found"


def test_the_first_rows_over_the_messages_at_an_end_are_those_over_all(past: Recorded) -> None:
    base = past.services.session.space.base
    now = datetime.fromtimestamp(time.time_ns() // 1000 / 1e6, timezone.utc)
    now_ns = int(now.timestamp() * 1e6) * 1000
    maker = PastMaker(base, datetime.fromtimestamp(past.start_ns // _SECOND, timezone.utc), SECONDS, now)
    full = store_of(past.described, past.everything)
    messages = TURNS * len(recorded.messages())
    shortened = refused = 0
    for seed in range(FIRST_ROWS):
        query, ending = maker.first_rows(seed)
        spelt = query.replace("NOW()", f'"{now.isoformat()}"^^xsd:dateTime')
        for most in (1, 2, 8):
            try:
                text, end = read_end(past, query + ending, now_ns, most)
                everything = rows_of(full, spelt, base)
            except (SyntaxError, Problem, OverflowError):
                refused += 1
                break
            if end is None:
                break
            found = rows_of(store_of(past.described, text), spelt + ending, base)
            if len(found) < end.rows:
                continue
            shortened += text.count(f"{ros.past}") < messages
            offset = end.messages - end.rows
            assert not Counter(found) - Counter(everything), f"seed {seed}: {query}{ending}"
            if "ORDER BY" in query:
                expected = everything[offset : offset + end.rows]
                assert [row[0] for row in found] == [row[0] for row in expected], f"seed {seed}: {query}{ending}"
            break
    assert refused < FIRST_ROWS / 4
    assert shortened > FIRST_ROWS / 10, "hardly anything is shortened"


def rows_of(store: Store, query: str, base: str) -> list[tuple[str, ...]]:
    """The rows of a query in their order, the value of ?t first."""
    found = store.query(query, base_iri=base, prefixes=dict(PREFIXES))
    assert isinstance(found, QuerySolutions)
    names = sorted((each.value for each in found.variables), key=lambda name: (name != "t", name))
    rows: list[tuple[str, ...]] = []
    for row in found:
        terms = [row[name] for name in names]
        rows.append(tuple("_" if isinstance(each, BlankNode) else str(each) for each in terms))
        if len(rows) > MAX_ROWS:
            raise OverflowError
    return rows
