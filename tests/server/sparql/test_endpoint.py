"""Queries answered: formats, limits, and what is told when they cannot be."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any
from xml.etree import ElementTree

import pytest
from pyoxigraph import RdfFormat, parse

from rosld.server.http.problem import Problem
from rosld.server.sparql.process.evaluation import MAX_FIRST_BYTES, Aborted
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.query_service import QueryAnswer, QuerySettings
from rosld.server.sparql.results import GRAPHS, SOLUTIONS, ResultRows

# The classes are those of conftest.py, which arrive as fixtures.
Make = Any
VALUE = "SELECT ?x { <topics/t3#message> <https://w3id.org/rosld/types/p/msg/T3#f0> ?x }"
CROSS = "SELECT * { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i }"
ENDLESS = f"{CROSS} ORDER BY ?a ?d ?g"


async def bytes_of(answer: QueryAnswer) -> bytes:
    if isinstance(answer.body, bytes):
        return answer.body
    return b"".join([chunk async for chunk in answer.body])


async def rows_in_time(endpoint: Any, query: str) -> list[str]:
    """The rows of a query, asked until its short limit of time is enough: a busy machine may stand still for longer."""
    while True:
        try:
            rows: list[str] = await endpoint.rows(query)
        except Problem as problem:
            if problem.status != 503:
                raise
        else:
            return rows


async def collect(body: AsyncIterator[bytes], chunks: list[bytes]) -> None:
    async for chunk in body:
        chunks.append(chunk)


@pytest.mark.parametrize("media_type", SOLUTIONS)
def test_select_and_ask_come_in_every_format_of_results(
    make_source: Make, make_endpoint: Make, run: Make, media_type: str
) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source())
        select = await endpoint.answer(VALUE, media_type)
        ask = await endpoint.answer("ASK { ?t a ros:Topic }", media_type)
        assert (select.media_type, ask.media_type) == (media_type, media_type)
        assert b"0.5" in await bytes_of(select)
        assert b"true" in await bytes_of(ask)
        if "json" in media_type:
            assert json.loads(await bytes_of(select))["head"] == {"vars": ["x"]}
        if "xml" in media_type:
            ElementTree.fromstring(await bytes_of(select))

    run(scenario())


@pytest.mark.parametrize("media_type", GRAPHS)
def test_construct_and_describe_come_in_every_syntax_of_rdf(
    make_source: Make, make_endpoint: Make, run: Make, media_type: str
) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source())
        expected = {f"<http://robot/topics/t3#message> <https://w3id.org/rosld/types/p/msg/T3#f{n}>" for n in range(3)}
        for query in ("CONSTRUCT WHERE { <topics/t3#message> ?p ?o }", "DESCRIBE <topics/t3#message>"):
            answer = await endpoint.answer(query, media_type)
            assert answer.media_type == media_type
            syntax = RdfFormat.JSON_LD if "json" in media_type else RdfFormat.from_media_type(media_type)
            found = parse(await bytes_of(answer), syntax)
            assert {f"{quad.subject} {quad.predicate}" for quad in found} == expected

    run(scenario())


def test_without_a_wish_results_are_json_and_graphs_turtle(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source())
        assert (await endpoint.answer(VALUE, None)).media_type == "application/sparql-results+json"
        assert (await endpoint.answer("DESCRIBE <topics/t3>", "*/*")).content_type == "text/turtle; charset=utf-8"
        assert (await endpoint.answer(VALUE, "text/csv")).content_type == "text/csv; charset=utf-8"

    run(scenario())


@pytest.mark.parametrize(
    ("query", "rows"),
    [
        ("SELECT (<h:f>(1) AS ?x) {}", [b""]),
        ("SELECT (COALESCE(<h:f>(1), 2) AS ?x) {}", [b"2"]),
        ("SELECT ?x { VALUES ?x { 1 2 } FILTER(<h:f>(?x) || ?x = 2) }", [b"2"]),
        ("SELECT ?x { VALUES ?x { 1 2 } FILTER(<h:f>(?x)) }", []),
        ("SELECT (xsd:byte('1') AS ?x) {}", [b""]),
        ("SELECT (xsd:date('2026-11-23') AS ?x) {}", [b"2026-11-23"]),
    ],
)
def test_calling_a_function_that_nobody_knows_is_an_error_of_its_expression(
    make_source: Make, make_endpoint: Make, run: Make, query: str, rows: list[bytes]
) -> None:
    async def scenario() -> None:
        answer = await make_endpoint(make_source()).answer(query, "text/csv")
        assert answer.body.splitlines()[1:] == rows

    run(scenario())


@pytest.mark.parametrize(
    ("query", "accept", "status", "words"),
    [
        (VALUE, "text/turtle", 406, "text/csv"),
        ("DESCRIBE <topics/t3>", "text/csv", 406, "text/turtle"),
        ("SELECT * { ?s ?p }", None, 400, "} at 1:18"),
        ("SELECT * { SERVICE <http://127.0.0.1:9/> { ?s ?p ?o } }", None, 400, "SERVICE"),
        ("DELETE WHERE { ?s ?p ?o }", None, 400, "DELETE"),
        ("SELECT * { " + "{" * 200 + "}" * 200 + " }", None, 400, "nests"),
        ("ASK { }" + " " * 70000, None, 413, "65536"),
        (
            "CONSTRUCT { ?s <http://h/ends/in/> ?o } WHERE { ?s ros:name ?o }",
            "application/rdf+xml",
            406,
            "http://h/ends/in/",
        ),
    ],
)
def test_what_cannot_be_answered_is_told_in_words(
    make_source: Make, make_endpoint: Make, run: Make, query: str, accept: str | None, status: int, words: str
) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source())
        with pytest.raises(Problem) as caught:
            await endpoint.answer(query, accept)
        assert caught.value.status == status
        assert words in caught.value.detail

    run(scenario())


def test_the_dataset_of_the_request_goes_before_that_of_the_query(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        query = "SELECT ?n FROM <topics/t1> { ?t ros:name ?n }"
        assert await endpoint.rows(query) == ["/t1"]
        request = QueryRequest(query, default_graphs=(source.url(2),))
        assert b"/t2" in await bytes_of(await endpoint.service.answer(request, "text/csv"))
        request = QueryRequest("SELECT ?x { GRAPH ?g { ?m ?p ?x } }", named_graphs=(source.url(4),))
        assert b"0.5" in await bytes_of(await endpoint.service.answer(request, "text/csv"))
        assert source.looks[-1].graphs == {source.url(4)}

    run(scenario())


def test_large_results_come_in_chunks_and_are_whole(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(1000))
        answer = await endpoint.answer("SELECT * { ?s ?p ?o . ?s ?q ?r }", "text/csv")
        assert isinstance(answer.body, AsyncIterator)
        chunks = [chunk async for chunk in answer.body]
        assert len(chunks) > 3
        assert max(map(len, chunks)) < MAX_FIRST_BYTES + 64 * 1024
        rows = 1000 * (4 * 4 + 3 * 3)
        assert b"".join(chunks).count(b"\r\n") == rows + 1

    run(scenario())


def test_a_query_that_takes_too_long_is_503_naming_the_limit(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(100), QuerySettings(time_limit=0.3))
        await rows_in_time(endpoint, VALUE)
        with pytest.raises(Problem) as caught:
            await endpoint.answer(ENDLESS)
        assert caught.value.status == 503
        assert "0.3 s" in caught.value.detail
        assert await rows_in_time(endpoint, VALUE) == ["0.5"]

    run(scenario())


def test_results_that_take_too_long_once_begun_break_off_and_never_look_whole(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(100), QuerySettings(time_limit=2.0))
        answer = await endpoint.answer(CROSS, "application/sparql-results+json")
        assert isinstance(answer.body, AsyncIterator)
        chunks: list[bytes] = []
        with pytest.raises(Aborted):
            await collect(answer.body, chunks)
        assert chunks
        with pytest.raises(json.JSONDecodeError):
            json.loads(b"".join(chunks))

    run(scenario())


def test_a_reader_that_goes_away_gives_its_worker_back(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(100), QuerySettings(time_limit=30, workers=1))
        for _ in range(3):
            answer = await endpoint.answer(CROSS)
            assert isinstance(answer.body, AsyncIterator)
            await answer.body.__anext__()
            await answer.body.aclose()  # type: ignore[attr-defined]
        assert await endpoint.rows("SELECT DISTINCT ?c { <topics/t3> a ?c }") == ["https://w3id.org/rosld#Topic"]

    run(scenario())


def test_when_all_workers_are_busy_and_enough_wait_it_is_503_to_come_again(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(100), QuerySettings(time_limit=3.0, workers=1, waiting=1))
        await endpoint.rows(VALUE)
        queries = [asyncio.ensure_future(endpoint.answer(f"{ENDLESS} LIMIT {n}")) for n in range(1, 6)]
        results = await asyncio.gather(*queries, return_exceptions=True)
        assert all(isinstance(result, Problem) and result.status == 503 for result in results)
        again = [result for result in results if isinstance(result, Problem) and "Retry-After" in result.headers]
        assert len(again) >= 3
        assert await endpoint.rows(VALUE) == ["0.5"]  # what is quick needs no worker

    run(scenario())


def test_a_page_gets_the_first_rows_as_terms(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source())
        await endpoint.start()
        table = await endpoint.service.table(QueryRequest("SELECT ?n { ?t ros:name ?n } ORDER BY ?n"), 2)
        assert table.variables == ("n",)
        assert [row[0].value for row in table.rows] == ["/t0", "/t1"]
        assert await endpoint.service.table(QueryRequest("ASK { }"), 2) == ResultRows(boolean=True)
        triples = await endpoint.service.table(QueryRequest("CONSTRUCT WHERE { ?s ros:name ?o }"), 5)
        assert triples.variables == ("subject", "predicate", "object")
        assert len(triples.rows) == 5

    run(scenario())


def test_queries_at_the_same_time_each_get_their_own_answer(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        endpoint = make_endpoint(make_source(50))
        queries = [f"SELECT DISTINCT ?n {{ <topics/t{n}> ros:name ?n }}" for n in range(50)]
        answers = await asyncio.gather(*(endpoint.rows(query) for query in queries))
        assert answers == [[f"/t{n}"] for n in range(50)]

    run(scenario())
