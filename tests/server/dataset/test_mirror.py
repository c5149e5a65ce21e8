"""The mirror: another store comes to hold what the dataset holds, and never holds anything else up."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import time
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias
from urllib.parse import parse_qs

import pytest

from rosld.server.dataset import Edit
from rosld.server.dataset.endpoint_client import Endpoint
from rosld.server.dataset.pending_changes import INITIAL_LIMIT
from rosld.server.dataset.remote_store import RemoteStore
from rosld.server.dataset.replication import Mirror, pause_after
from tests.server.sparql.local import LocalStore

if TYPE_CHECKING:
    from tests.server.dataset.conftest import Behaviour, Failing, Oxigraph

Start: TypeAlias = "Callable[[Behaviour], Failing]"
BASE, OTHER = "http://one/", "http://two/"
P = "<http://h/p>"
EMPTY = b'{"head":{"vars":["g"]},"results":{"bindings":[]}}'
JSON = "application/sparql-results+json"


class Graphs:
    base = BASE
    heartbeat_graph = BASE + "mirror"

    def is_ours(self, graph: str) -> bool:
        return graph.startswith(BASE + "g/")

    def transient_graphs(self) -> Collection[str]:
        return [f"{BASE}g/1"]


def text(value: object) -> str:
    return f'<http://h/s> {P} "{value}" .\n'


def graph(number: int) -> str:
    return f"{BASE}g/{number}"


async def nothing() -> None:
    pass


async def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Until it holds: there is nothing to wait for in another server but what it answers."""
    end = time.monotonic() + seconds
    while not await asyncio.to_thread(condition):
        assert time.monotonic() < end, "it never came to hold"
        await asyncio.sleep(0.02)


@asynccontextmanager
async def mirroring(
    source: LocalStore, target: RemoteStore, run_name: str = "run", max_pending: int = INITIAL_LIMIT
) -> AsyncIterator[Mirror]:
    mirror = Mirror(
        source,
        target,
        Graphs(),
        nothing,
        interval=0.02,
        run_name=run_name,
        first_pause=0.05,
        max_pending=max_pending,
        renewal_seconds=1.0,
    )
    running = asyncio.ensure_future(mirror.run())
    try:
        yield mirror
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def values(oxigraph: Oxigraph, name: str) -> list[str]:
    return sorted(row["o"] for row in oxigraph.select(f"SELECT ?o {{ GRAPH <{name}> {{ ?s {P} ?o }} }}"))


def sealed(oxigraph: Oxigraph) -> str:
    """When the mirror told the store something last, as the store says."""
    [row] = oxigraph.select(
        f"SELECT ?m {{ GRAPH <{Graphs.heartbeat_graph}> {{ ?s <http://purl.org/dc/terms/modified> ?m }} }}"
    )
    return row["m"]


def test_all_there_was_and_all_that_changes_gets_there_and_what_goes_goes(oxigraph: Oxigraph) -> None:
    async def run() -> None:
        source = LocalStore()
        source.replace({graph(1): text(1), graph(2): f'_:b {P} _:c .\n_:c {P} "end" .\n', graph(3): text(3)})
        async with mirroring(source, oxigraph.store()):
            await until(lambda: {graph(1), graph(2), graph(3)} <= oxigraph.graphs())
            source.replace({graph(1): text("new"), graph(3): None}, [Edit(graph(4), added=text(4))])
            source.replace({}, [Edit(graph(4), added=text(5), removed=text(4))])
            await until(lambda: graph(3) not in oxigraph.graphs() and values(oxigraph, graph(4)) == ["5"])
        assert values(oxigraph, graph(1)) == ["new"]
        joined = oxigraph.select(f'SELECT ?s {{ GRAPH <{graph(2)}> {{ ?s {P} ?b . ?b {P} "end" }} }}')
        assert len(joined) == 1

    asyncio.run(run())


def test_what_an_earlier_run_left_is_taken_away_and_what_others_told_is_not_touched(oxigraph: Oxigraph) -> None:
    others = {f"{OTHER}g/1", f"{BASE}below/g/1", "http://on", "http://h/else"}
    for name in (*others, graph(7), graph(8)):
        oxigraph.update(f"INSERT DATA {{ GRAPH <{name}> {{ {text('old')} }} }}")

    async def run() -> None:
        source = LocalStore()
        source.replace({graph(1): text(1), graph(8): text("new")})
        async with mirroring(source, oxigraph.store()):
            await until(lambda: graph(1) in oxigraph.graphs() and graph(7) not in oxigraph.graphs())
        assert oxigraph.graphs() == {*others, graph(1), graph(8), Graphs.heartbeat_graph}
        assert values(oxigraph, graph(8)) == ["new"]

    asyncio.run(run())


def test_an_endpoint_that_goes_away_is_caught_up_with_when_it_is_back_although_it_lost_everything(
    new_oxigraph: Callable[[], Oxigraph], caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        oxigraph, source = new_oxigraph(), LocalStore()
        source.replace({graph(1): text(1), graph(2): text(2)})
        with caplog.at_level(logging.WARNING, "rosld.store"):
            async with mirroring(source, oxigraph.store()) as mirror:
                await until(lambda: graph(2) in oxigraph.graphs() and mirror.status.lag == 0)
                oxigraph.stop()
                await until(lambda: mirror.status.failure is not None)
                for turn in range(5000):
                    source.replace({graph(1): text(turn)})
                assert mirror.status.pending <= 2
                lag = mirror.status.lag
                await until(lambda: mirror.status.lag > lag > 0)
                oxigraph.start()
                await until(lambda: mirror.status.failure is None and mirror.status.lag == 0)
                await until(lambda: values(oxigraph, graph(1)) == ["4999"] and values(oxigraph, graph(2)) == ["2"])
        told = [record.getMessage() for record in caplog.records]
        assert ["behind" in each for each in told] == [True, False]
        assert "again" in told[1]
        assert oxigraph.url in told[0]
        assert oxigraph.url in told[1]

    asyncio.run(run())


def test_a_store_that_kept_what_it_has_is_told_only_what_changed(
    new_oxigraph: Callable[..., Oxigraph], tmp_path: Path
) -> None:
    async def run() -> None:
        oxigraph, source = new_oxigraph(tmp_path), LocalStore()
        source.replace({graph(1): text(1), graph(2): text(2)})
        async with mirroring(source, oxigraph.store()) as mirror:
            await until(lambda: graph(2) in oxigraph.graphs() and mirror.status.lag == 0)
            oxigraph.update(f"INSERT DATA {{ GRAPH <{graph(2)}> {{ {text('by hand')} }} }}")
            oxigraph.stop()
            await until(lambda: mirror.status.failure is not None)
            source.replace({graph(1): text("new")})
            oxigraph.start()
            await until(lambda: values(oxigraph, graph(1)) == ["new"])
        assert values(oxigraph, graph(2)) == ["2", "by hand"]

    asyncio.run(run())


def test_a_store_put_back_to_an_earlier_day_is_told_everything_anew(
    new_oxigraph: Callable[..., Oxigraph], tmp_path: Path
) -> None:
    async def run() -> None:
        oxigraph, source = new_oxigraph(tmp_path), LocalStore()
        source.replace({graph(1): text(1)})
        async with mirroring(source, oxigraph.store()) as mirror:
            await until(lambda: graph(1) in oxigraph.graphs() and mirror.status.lag == 0)
            earlier = sealed(oxigraph)
            for _ in range(2):  # after the second the mirror knows of the first
                now = sealed(oxigraph)
                await until(lambda now=now: sealed(oxigraph) != now)
            oxigraph.stop()
            await until(lambda: mirror.status.failure is not None)
            elsewhere = new_oxigraph(tmp_path)  # on a port that the mirror does not know
            elsewhere.update(
                f"DROP GRAPH <{graph(1)}> ; DELETE {{ GRAPH ?g {{ ?s ?p ?o }} }} INSERT {{ GRAPH ?g {{ ?s ?p "
                f'"{earlier}"^^<http://www.w3.org/2001/XMLSchema#dateTime> }} }} '
                f"WHERE {{ GRAPH ?g {{ ?s ?p ?o FILTER(?p = <http://purl.org/dc/terms/modified>) }} }}"
            )
            elsewhere.stop()
            oxigraph.start()
            await until(lambda: graph(1) in oxigraph.graphs())

    asyncio.run(run())


def test_at_the_end_what_was_true_only_of_the_run_goes_and_the_seal_says_so(oxigraph: Oxigraph) -> None:
    async def run() -> None:
        source = LocalStore()
        source.replace({graph(1): text(1), graph(2): text(2)})
        async with mirroring(source, oxigraph.store()) as mirror:
            await until(lambda: graph(2) in oxigraph.graphs() and mirror.status.lag == 0)
        await mirror.close()
        assert oxigraph.graphs() == {graph(2), Graphs.heartbeat_graph}
        rows = oxigraph.select(
            f"SELECT ?o {{ GRAPH <{Graphs.heartbeat_graph}> {{ ?s <https://w3id.org/rosld#state> ?o }} }}"
        )
        assert [row["o"] for row in rows] == ["https://w3id.org/rosld#Stale"]

    asyncio.run(run())


def test_a_graph_larger_than_a_request_comes_in_parts_its_blank_nodes_whole(oxigraph: Oxigraph) -> None:
    large = "".join(
        f'<http://h/{n}> {P} "{"x" * 1000}" .\n_:b{n} {P} _:c{n} .\n_:c{n} {P} "{n}" .\n' for n in range(3000)
    )

    async def run() -> None:
        source = LocalStore()
        source.replace({graph(1): large, graph(2): text(2)})
        async with mirroring(source, oxigraph.store()) as mirror:
            await until(lambda: mirror.status.updated_ns is not None and mirror.status.lag == 0)
        [counted] = oxigraph.select(f"SELECT (COUNT(*) AS ?n) {{ GRAPH <{graph(1)}> {{ ?s ?p ?o }} }}")
        [joined] = oxigraph.select(f"SELECT (COUNT(*) AS ?n) {{ GRAPH <{graph(1)}> {{ ?s {P} ?c . ?c {P} ?o }} }}")
        assert (counted["n"], joined["n"]) == ("9000", "3000")

    asyncio.run(run())


def test_where_too_much_waits_to_be_kept_apart_everything_is_told_anew(
    new_oxigraph: Callable[[], Oxigraph], caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        oxigraph, source = new_oxigraph(), LocalStore()
        source.replace({graph(1): text(1), graph(2): text(2)})
        async with mirroring(source, oxigraph.store(), max_pending=10) as mirror:
            await until(lambda: graph(2) in oxigraph.graphs() and mirror.status.lag == 0)
            oxigraph.stop()
            await until(lambda: mirror.status.failure is not None)
            source.replace({graph(1): text("new"), graph(2): None})
            for number in range(100, 200):
                source.replace({graph(number): text(number)})
                source.replace({graph(number): None})
                assert mirror.status.pending <= 12
            oxigraph.start()
            await until(lambda: values(oxigraph, graph(1)) == ["new"])
            assert oxigraph.graphs() == {graph(1), Graphs.heartbeat_graph}
        assert any("anew" in record.getMessage() for record in caplog.records)

    asyncio.run(run())


def picky(server: Failing, connection: socket.socket, body: bytes) -> bool:
    """Takes everything but what is poison."""
    if b"query=" in body:
        return server.answer(connection, "200 OK", EMPTY, JSON)
    if b"poison" in body:
        return server.answer(connection, "400 Bad", b"I do not take this")
    return server.answer(connection, "204 Done")


def test_a_graph_that_is_refused_is_left_out_and_keeps_no_other_back(
    failing: Start, caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        server, source = failing(picky), LocalStore()
        source.replace({graph(number): text("poison" if number == 33 else f"value {number}.") for number in range(100)})
        store = RemoteStore(Endpoint(server.url, seconds=5), Endpoint(server.url, seconds=5))
        async with mirroring(source, store) as mirror:
            await until(lambda: mirror.status.refused == 1 and mirror.status.lag == 0)
            for number in (33, 34):
                source.replace({graph(number): text(f"poison {number}" if number == 33 else "the last one")})
            await until(lambda: any(b"the last one" in body for body in server.bodies))
            await until(lambda: mirror.status.lag == 0)
        taken = b"".join(body for body in server.bodies if b"poison" not in body)
        assert all(f"value {number}.".encode() in taken for number in range(100) if number != 33)
        assert sum(b"poison" in body for body in server.bodies) < 20
        left_out = [record.getMessage() for record in caplog.records if "left out" in record.getMessage()]
        assert len(left_out) == 1
        assert graph(33) in left_out[0]

    asyncio.run(run())


def refusing_all(server: Failing, connection: socket.socket, body: bytes) -> bool:
    return server.answer(connection, "500 Broken", b"broken")


def refusing_updates(server: Failing, connection: socket.socket, body: bytes) -> bool:
    if b"query=" in body:
        return server.answer(connection, "200 OK", EMPTY, JSON)
    return refusing_all(server, connection, body)


def silent(server: Failing, connection: socket.socket, body: bytes) -> bool:
    server.ended.wait(60)
    return False


def naming_others(server: Failing, connection: socket.socket, body: bytes) -> bool:
    """Claims that graphs of others were asked for."""
    if b"query=" in body:
        found = b'{"head":{"vars":["g"]},"results":{"bindings":[{"g":{"type":"uri","value":"http://two/g/1"}}]}}'
        return server.answer(connection, "200 OK", found, JSON)
    return server.answer(connection, "204 Done")


def test_an_endpoint_is_tried_half_as_often_with_each_failure_until_once_a_minute() -> None:
    for failures in range(1, 100):
        longest = min(60.0, 0.05 * 2 ** (failures - 1))
        assert all(longest / 2 <= pause_after(failures, 0.05) <= longest for _ in range(100))


@pytest.mark.parametrize("behave", [refusing_all, refusing_updates, silent], ids=lambda behave: behave.__name__)
def test_where_an_endpoint_fails_all_the_time_nothing_grows_and_the_end_is_quick(
    behave: Behaviour, failing: Start, caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        server, source = failing(behave), LocalStore()
        store = RemoteStore(Endpoint(server.url, seconds=0.1), Endpoint(server.url, seconds=0.1))
        async with mirroring(source, store) as mirror:
            for number in range(50):
                source.replace({graph(number % 5): text(number)})
            await until(lambda: len(server.bodies) >= 4)
            assert mirror.status.pending <= 5
            assert mirror.status.failure is not None
        await asyncio.wait_for(mirror.close(), 30)
        assert len([record for record in caplog.records if "behind" in record.getMessage()]) == 1

    asyncio.run(run())


def test_an_end_while_the_endpoint_is_silent_is_quick(failing: Start) -> None:
    async def run() -> None:
        server = failing(silent)
        store = RemoteStore(Endpoint(server.url, seconds=60), Endpoint(server.url, seconds=60))
        async with mirroring(LocalStore(), store) as mirror:
            await until(lambda: len(server.bodies) > 0)
        begun = time.monotonic()
        await mirror.close()
        assert time.monotonic() - begun < 30

    asyncio.run(run())


def test_graphs_of_others_are_not_dropped_even_where_the_endpoint_calls_them_ours(failing: Start) -> None:
    async def run() -> None:
        server, source = failing(naming_others), LocalStore()
        source.replace({graph(1): text(1)})
        async with mirroring(source, RemoteStore(Endpoint(server.url), Endpoint(server.url))) as mirror:
            await until(lambda: mirror.status.updated_ns is not None and mirror.status.lag == 0)
        assert not any(OTHER.encode() in body for body in server.bodies if b"query" not in parse_qs(body))

    asyncio.run(run())


def test_what_cannot_be_read_from_the_robot_does_not_keep_back_the_rest(oxigraph: Oxigraph) -> None:
    async def gone() -> None:
        raise RuntimeError("the robot is gone")

    async def run() -> None:
        source = LocalStore()
        source.replace({graph(1): text(1)})
        mirror = Mirror(source, oxigraph.store(), Graphs(), gone, interval=0.02, run_name="run")
        running = asyncio.ensure_future(mirror.run())
        await until(lambda: graph(1) in oxigraph.graphs())
        running.cancel()
        await asyncio.wait([running])

    asyncio.run(run())
