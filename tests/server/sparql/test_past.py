"""Queries of the past over HTTP have the results of pyoxigraph over all recorded messages."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from pyoxigraph import (
    BlankNode,
    NamedNode,
    QueryBoolean,
    QueryResultsFormat,
    QuerySolutions,
    RdfFormat,
    Store,
    parse,
    parse_query_results,
)
from rosbags.rosbag2 import StoragePlugin, Writer

from rosld.ontology.vocab import PREFIXES, rdf, ros, xsd
from tests.server.sparql import recorded
from tests.server.sparql.past_at_random import PastMaker
from tests.waiting import once_started

pytestmark = pytest.mark.slow

QUERIES = 80
FIRST_ROWS = 40
MAX_ROWS = 3000
TURNS = 8
SECONDS = 4.0
_SECOND = 1_000_000_000


class Recorded(NamedTuple):
    """A server that plays a recording, and a store with all statements about its messages, recorded from `start` on."""

    http: httpx.Client
    full: Store
    functions: dict[NamedNode, Callable[..., Any]]
    start: datetime


def write(folder: Path, start_ns: int) -> Path:
    """Write a recording of the topics of `recorded.py`, each several times, at different times."""
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
def past(tmp_path_factory: pytest.TempPathFactory, start_server: Callable[..., Any]) -> Recorded:
    """A recording that began a minute ago."""
    start_ns = time.time_ns() // _SECOND * _SECOND - 60 * _SECOND
    source = str(write(tmp_path_factory.mktemp("past") / "run", start_ns))
    http: httpx.Client = start_server(source).http
    once_started(lambda: http.get("/sparql", params={"query": "ASK {}"}))
    full = everything(http)
    return Recorded(http, full, functions(full), datetime.fromtimestamp(start_ns // _SECOND, timezone.utc))


def everything(http: httpx.Client) -> Store:
    """Return all statements about topics, all messages from their own URLs, and the links to these."""
    store, base, ntriples = Store(), str(http.base_url), {"Accept": "application/n-triples"}
    for topic, message in recorded.messages():
        node, name = f"<{base}topics{topic}>", f"<https://w3id.org/rosld/types/{message.__msgtype__}>"
        lines = f'{node} {ros.name} "{topic}" ; a {ros.Topic} ; {ros.hasMessageType} {name} .'
        store.load(lines, RdfFormat.TURTLE)
    for index in range(TURNS * len(recorded.messages())):
        url = f"{base}bags/run/messages/{index}"
        found = [quad.triple for quad in parse(http.get(url, headers=ntriples).content, RdfFormat.N_TRIPLES)]
        [topic] = [str(each.object) for each in found if each.predicate == ros.onTopic]
        store.load("".join(f"{each} .\n" for each in found), RdfFormat.N_TRIPLES)
        link = f"{topic} {ros.past} <{url}#message> .\n<{url}#message> {ros.recordedIn} <{base}bags/run/> .\n"
        store.load(link, RdfFormat.N_TRIPLES)
    return store


def spelt(query: str, now: datetime) -> str:
    return query.replace("NOW()", f'"{now.isoformat()}"^^xsd:dateTime')


def rows_of(found: Any) -> list[tuple[str, ...]]:
    """Return the rows of a result in order, the value of ?t first, without labels of blank nodes and number types."""
    if isinstance(found, QueryBoolean):
        return [(str(bool(found)),)]
    names = None
    if isinstance(found, QuerySolutions):
        names = sorted((each.value for each in found.variables), key=lambda name: (name != "t", name))
    rows: list[tuple[str, ...]] = []
    for row in found:
        terms = (row.subject, row.predicate, row.object) if names is None else [row[name] for name in names]
        rows.append(tuple("_" if isinstance(each, BlankNode) else shown(each) for each in terms))
        if len(rows) > MAX_ROWS:
            raise OverflowError
    return rows if names is not None else sorted(set(rows))


def shown(term: object) -> str:
    """Return a term by its value: the server returns its lexical form, pyoxigraph a normalized one."""
    store = Store()
    found = store.query(f"SELECT ({term} AS ?x) {{}}") if str(term).startswith('"') else None
    return str(term if found is None else next(iter(found))[0])  # type: ignore[arg-type, index]


def expected(past: Recorded, query: str) -> list[tuple[str, ...]]:
    query = _MESSAGE.sub(rf"COALESCE(\1, {rdf.nil})", query)
    found = past.full.query(
        query, base_iri=str(past.http.base_url), prefixes=dict(PREFIXES), custom_functions=past.functions
    )
    return rows_of(found)


_MESSAGE = re.compile(r"(ros:(?:asOf|previous)\([^()]*\))")


def functions(full: Store) -> dict[NamedNode, Callable[..., Any]]:
    """Return `ros:asOf` and `ros:previous` over all messages, in SPARQL."""

    def newest(where: str) -> Any:
        found = full.query(f"SELECT ?found {{ {where} }} ORDER BY DESC(?time) LIMIT 1")
        assert isinstance(found, QuerySolutions)
        return next((row[0] for row in found), None)

    def as_of(topic: Any, time: Any) -> Any:
        is_time = isinstance(topic, NamedNode) and getattr(time, "datatype", None) == xsd.dateTime
        every = f"{topic} {ros.past} ?found . ?found {ros.received} ?time FILTER(?time <= {time})"
        return newest(every) if is_time else None

    def previous(message: Any) -> Any:
        if not isinstance(message, NamedNode):
            return None
        own = f"?topic {ros.past} {message}, ?found . {message} {ros.received} ?own . ?found {ros.received} ?time"
        return newest(f"{own} FILTER(?time < ?own)")

    return {ros.asOf: as_of, ros.previous: previous}


ACCEPT = "application/sparql-results+json, application/n-triples;q=0.9, application/problem+json;q=0.8"


def answered(past: Recorded, query: str) -> list[tuple[str, ...]] | None:
    """Return the server's result, None if it refuses the query."""
    headers = {"Content-Type": "application/sparql-query", "Accept": ACCEPT}
    answer = past.http.post("/sparql", content=query, headers=headers)
    if answer.status_code in (400, 503):
        return None
    assert answer.status_code == 200, (query, answer.text)
    if "json" in answer.headers["content-type"]:
        return rows_of(parse_query_results(answer.content, QueryResultsFormat.JSON))
    return rows_of(quad.triple for quad in parse(answer.content, RdfFormat.N_TRIPLES))


class Compared(NamedTuple):
    """A query without its LIMIT, the server's result with it, and all rows."""

    query: str
    ending: str
    rows: list[tuple[str, ...]]
    everything: list[tuple[str, ...]]

    @property
    def agrees(self) -> bool:
        if not self.ending:
            return sorted(self.rows) == sorted(self.everything)
        limit, _, offset = self.ending.removeprefix(" LIMIT ").partition(" OFFSET ")
        first = self.everything[int(offset or 0) :][: int(limit)]
        is_ordered = "ORDER BY" not in self.query or [row[0] for row in self.rows] == [row[0] for row in first]
        return len(self.rows) == len(first) and set(self.rows) <= set(self.everything) and is_ordered


def compare(past: Recorded, make: Callable[[PastMaker], tuple[str, str]]) -> Compared | None:
    """Compare a query, None if it is refused; repeat it if NOW() may have passed a message meanwhile."""
    for _ in range(4):
        now = datetime.now(timezone.utc)
        query, ending = make(PastMaker(str(past.http.base_url), past.start, SECONDS, now))
        try:
            rows = answered(past, query + ending)
            if rows is None:
                return None
            for moment in (now, datetime.now(timezone.utc)):
                found = Compared(query, ending, rows, expected(past, spelt(query, moment)))
                if found.agrees:
                    return found
        except (SyntaxError, OverflowError):
            return None
    return found


def test_a_query_answers_as_over_all_that_is_recorded(past: Recorded) -> None:
    compared = [compare(past, lambda maker, seed=seed: (maker.query(seed), "")) for seed in range(QUERIES)]  # type: ignore[misc]
    taken = [each for each in compared if each is not None]
    wrong = [each for each in taken if not each.agrees]
    assert not wrong, wrong[:2]
    assert len(taken) > QUERIES / 2
    assert sum(each.rows not in ([], [("False",)]) for each in taken) > QUERIES / 5, "hardly anything is found"


def test_the_first_rows_are_those_of_all_rows(past: Recorded) -> None:
    compared = [compare(past, lambda maker, seed=seed: maker.first_rows(seed)) for seed in range(FIRST_ROWS)]  # type: ignore[misc]
    taken = [each for each in compared if each is not None]
    wrong = [each for each in taken if not each.agrees]
    assert not wrong, wrong[:2]
    assert len(taken) > FIRST_ROWS / 2
