"""Cost of queries with restricted permissions: the union, an explicit dataset, a restricted one.

Run: python bench/rights.py [graphs]. The dataset has this number of graphs of 20 statements; the agent may read 9 of
10.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable

from rosld.ontology.urls import Space
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.rules import Agent, Glob, Mode, Policy, Rule
from rosld.server.dataset import MemoryStore
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import AnswerWork, QueryWork
from rosld.server.sparql.query_limits import Limits
from rosld.server.sparql.restricted import RestrictedDatasets

SPACE = Space("http://robot.example/")
QUERY = "SELECT ?o {{ <{subject}> <http://example.org/p3> ?o }}"
ALL = "SELECT (COUNT(*) AS ?n) { ?s <http://example.org/p3> ?o }"
ROUNDS = 200


def graph(number: int, value: int = 0) -> tuple[str, str]:
    url = SPACE.topic(f"/t{number % 10}/n{number}")
    return url, "".join(f'<{url}> <http://example.org/p{each}> "{value}" .\n' for each in range(20))


def permissions() -> Permissions:
    everywhere, part = (Glob("/**"),), (Glob("/topics/t0/**"),)
    agent, read = Agent("anna"), frozenset({Mode.READ})
    rules = (Rule(frozenset({"anna"}), read, everywhere), Rule(frozenset({"anna"}), read, part, deny=True))
    return Permissions(agent, Policy(rules).rights_of(agent), SPACE)


def timed(what: str, work: Callable[[], object], rounds: int = ROUNDS) -> None:
    started = time.perf_counter()
    for _ in range(rounds):
        work()
    print(f"{what:60} {(time.perf_counter() - started) / rounds * 1e6:10.0f} us")


async def main(count: int) -> None:
    store, anna = MemoryStore(), permissions()
    store.replace(dict(map(graph, range(count))))
    readable = [url for url in store.graphs() if anna.may_read(url)]
    small = QUERY.format(subject=graph(1)[0])
    for name, query, rounds in (("one value", small, ROUNDS), ("a scan", ALL, 10)):
        timed(f"{name}, the plain union", lambda query=query: list(store.query(query)), rounds)  # type: ignore[misc]
        timed(
            f"{name}, an explicit dataset of {len(readable)} graphs",
            lambda query=query: list(store.query(query, default_graphs=readable)),  # type: ignore[misc]
            rounds,
        )
    await restricted(anna, count, small)


async def restricted(anna: Permissions, count: int, small: str) -> None:
    """Measure the restricted dataset: creating, querying and updating it."""
    limits, process = Limits(), QueryProcess(4, 256)
    await process.start()
    process.change(dict(map(graph, range(count))))
    datasets = RestrictedDatasets(process, lambda: 0)
    analyser = Analyser(SPACE.base, SPACE.types)

    async def caught_up() -> int:
        return await datasets.dataset_for(anna, limits, time.monotonic() + 60)

    async def ask(query: str) -> None:
        found = analyser.analyse(query)
        work = AnswerWork(QueryWork(found.text, SPACE.base, found.prefixes, (), ()), "text/csv", 1_000_000)
        await process.answer(work, limits, time.monotonic() + 60, None, await caught_up())

    started = time.perf_counter()
    await caught_up()
    print(f"{'the restricted dataset, made':60} {(time.perf_counter() - started) * 1e6:10.0f} us")
    for name, query, rounds in (("one value", small, ROUNDS), ("a scan", ALL, 10)):
        started = time.perf_counter()
        for _ in range(rounds):
            await ask(query)
        took = (time.perf_counter() - started) / rounds
        print(f"{f'{name}, the restricted dataset, sent and answered':60} {took * 1e6:10.0f} us")
    took = 0.0
    for turn in range(20):
        process.change(dict(graph(number, turn) for number in range(10)))
        started = time.perf_counter()
        await caught_up()
        took += time.perf_counter() - started
    print(f"{'10 graphs that changed, brought to the restricted dataset':60} {took / 20 * 1e6:10.0f} us")
    await process.close()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000))
