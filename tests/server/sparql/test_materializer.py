"""Before a query, the store is brought to what it needs: no less, no more, and all at once."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest


class _Clock:
    """A clock that goes on by a step each time that it is read."""

    def __init__(self, step: float) -> None:
        self._now, self._step = 0.0, step

    def monotonic(self) -> float:
        self._now += self._step
        return self._now


# The classes are those of conftest.py, which arrive as fixtures.
Make = Any
ALL = "SELECT (COUNT(*) AS ?n) { ?s ?p ?o }"


def value(topic: int, field: int = 0) -> str:
    kind = f"https://w3id.org/rosld/types/p/msg/T{topic % 10}"
    return f"SELECT ?x {{ <http://robot/topics/t{topic}#message> <{kind}#f{field}> ?x }}"


def test_a_query_sees_the_values_of_now(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        for turn in range(3):
            assert await endpoint.rows(value(3)) == [f"{turn}.5"]
            source.tick()

    run(scenario())


def test_only_what_a_query_names_is_rendered(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source(1000)
        endpoint = make_endpoint(source)
        await endpoint.text(ALL)
        source.tick()
        source.rendered.clear()
        await endpoint.rows(value(3))
        assert source.rendered == [source.url(3)]
        source.rendered.clear()
        await endpoint.rows("SELECT ?x { ?m <https://w3id.org/rosld/types/p/msg/T7#f0> ?x }")
        assert len(source.rendered) == 100

    run(scenario())


def test_nothing_is_rendered_twice_while_nothing_changes(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source, interval=0.0)
        await endpoint.text(ALL)
        version = endpoint.process.version
        source.rendered.clear()
        await endpoint.text(ALL)
        await endpoint.rows(value(3))
        await endpoint.rows("SELECT * { ?t a ros:Topic }")
        assert source.rendered == []
        assert endpoint.process.version == version

    run(scenario())


def test_a_query_about_topics_does_not_look_at_values(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        assert len(await endpoint.rows("SELECT ?t { ?t a ros:Topic ; ros:name ?n }")) == 20
        assert source.looks == []

    run(scenario())


def test_a_changed_description_is_seen_and_a_topic_that_went_is_gone(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        await endpoint.rows(value(19))
        source.revision, source.count = 1, 19
        seen = await endpoint.rows("SELECT DISTINCT ?n (COUNT(*) AS ?c) { ?t ros:namespace ?n } GROUP BY ?n")
        assert seen == ["http://robot/revisions/1,19"]
        assert source.url(19) not in await endpoint.graphs()
        assert await endpoint.rows(value(19)) == []

    run(scenario())


def test_a_new_description_of_a_live_graph_keeps_its_values_for_who_asks(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        await endpoint.rows(value(3))
        source.revision = 1
        assert await endpoint.rows(value(3)) == ["0.5"]
        assert await endpoint.rows("SELECT ?n { <topics/t3> ros:namespace ?n }") == ["http://robot/revisions/1"]

    run(scenario())


def test_values_that_nobody_receives_any_more_are_not_shown_by_a_wildcard(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source, interval=0.0)
        await endpoint.rows(value(3))
        source.silent.add(3)
        assert "http://robot/topics/t3#message" not in await endpoint.rows("SELECT ?o { ?s ?p ?o }")
        assert "/t3" in await endpoint.rows("SELECT ?o { ?s ?p ?o }")

    run(scenario())


def test_a_wildcard_looks_at_everything_no_more_often_than_its_interval(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source, interval=3600.0)
        for _ in range(5):
            await endpoint.text(ALL)
        assert len(source.looks) == 1
        source.tick()
        assert await endpoint.rows(value(3)) == ["1.5"]  # what is named is always of now
        assert len(source.looks) == 2

    run(scenario())


def test_a_look_at_messages_is_none_at_parameters(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source, interval=3600.0)
        await endpoint.text("SELECT * { ?t ros:rate ?r }")
        await endpoint.text(ALL)
        assert [look.needs_parameters for look in source.looks] == [False, True]

    run(scenario())


def test_a_document_that_is_there_only_when_named_goes_with_the_next_query(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        message = "http://robot/bags/run/messages/3"
        source.bags[message] = "hello"
        query = f"SELECT ?w {{ <{message}> ros:words ?w }}"
        assert await endpoint.rows(query) == ["hello"]
        source.bags[message] = "changed"
        assert await endpoint.rows(query) == ["changed"]
        await endpoint.rows(value(1))
        assert message not in await endpoint.graphs()

    run(scenario())


def test_another_query_does_not_take_away_what_one_has_named_and_not_yet_seen(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        message = "http://robot/bags/run/messages/3"
        source.bags[message] = "hello"
        await endpoint.start()
        named = endpoint.service.check(f"SELECT * {{ <{message}> ros:words ?w }}").needs
        other = endpoint.service.check(value(1)).needs
        deadline = asyncio.get_running_loop().time() + 10
        async with endpoint.materializer.materialize(named, deadline=deadline):
            async with endpoint.materializer.materialize(other, deadline=deadline):
                assert message in await endpoint.graphs()
            assert message in await endpoint.graphs()
        async with endpoint.materializer.materialize(other, deadline=deadline):
            assert message not in await endpoint.graphs()

    run(scenario())


def test_what_a_look_at_everything_rests_on_stays_though_it_grows_old_meanwhile(
    make_source: Make, make_endpoint: Make, run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        source = make_source()
        status = "http://robot/status"
        source.unnamed[status] = "fine"
        endpoint = make_endpoint(source, interval=1.5)
        for step in (0.0, 1.0):  # the second time the look is 1 s old at first, and 2 s when it is asked for once more
            monkeypatch.setattr("rosld.server.sparql.materializer.time", _Clock(step))
            await endpoint.text(ALL)
            assert status in await endpoint.graphs()
        assert len(source.looks) == 1

    run(scenario())


def test_what_was_to_go_when_a_query_that_rests_on_it_began_stays(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source(1000, 20)
        status = "http://robot/status"
        source.unnamed[status] = "fine"
        endpoint = make_endpoint(source, interval=3600.0)
        await endpoint.start()
        deadline = asyncio.get_running_loop().time() + 30
        everything = endpoint.service.check(ALL).needs
        values = endpoint.service.check("SELECT ?x { ?m <https://w3id.org/rosld/types/p/msg/T7#f0> ?x }").needs
        may_go_on = asyncio.Event()
        source.pause = may_go_on.wait
        other = asyncio.ensure_future(endpoint.materializer.begin(values, None, deadline))
        while not source.looks:  # noqa: ASYNC110 - what it is at, it tells nobody
            await asyncio.sleep(0)
        source.pause = None
        endpoint.materializer.end(await endpoint.materializer.begin(everything, None, deadline))
        source.tick()
        source.rendered.clear()
        may_go_on.set()
        while not source.rendered:  # noqa: ASYNC110
            await asyncio.sleep(0)
        await endpoint.materializer.begin(everything, None, deadline)
        await other
        assert len(source.looks) == 2
        assert status in await endpoint.graphs()

    run(scenario())


def test_a_slow_look_does_not_bring_back_older_values(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        await endpoint.rows(value(3))
        is_read, may_return = asyncio.Event(), asyncio.Event()

        async def delay() -> None:
            source.delay = None
            is_read.set()
            await may_return.wait()

        source.delay = delay
        slow = asyncio.ensure_future(endpoint.rows(value(3)))
        await is_read.wait()
        source.tick()
        assert await endpoint.rows(value(3)) == ["1.5"]
        may_return.set()
        await slow
        assert '"1.5"^^' in await endpoint.graph("http://robot/topics/t3")

    run(scenario())


def test_many_queries_at_once_render_each_change_once(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        await endpoint.text(ALL)
        for _ in range(5):
            source.tick()
            source.rendered.clear()
            answers = await asyncio.gather(*(endpoint.rows(value(3)) for _ in range(20)))
            assert all(answer == answers[0] for answer in answers)
            assert source.rendered == [source.url(3)]

    run(scenario())


def test_a_query_that_is_given_up_leaves_the_materializer_in_order(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source(300)
        endpoint = make_endpoint(source)
        await endpoint.start()
        task = asyncio.ensure_future(endpoint.text(ALL))
        await asyncio.sleep(0)  # it is under way now, and has come to its change
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        source.tick()
        assert await endpoint.rows(value(3)) == ["1.5"]
        assert len(await endpoint.rows("SELECT ?t { ?t a ros:Topic }")) == 300

    run(scenario())


def test_one_graph_that_cannot_be_rendered_or_stored_hides_no_other(
    make_source: Make, make_endpoint: Make, run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)
        whole = source.message

        def broken(url: str, topic: int, value: int) -> str:
            if topic == 3:
                raise RuntimeError("no such field")
            return "} ; DROP ALL" if topic == 13 else whole(url, topic, value)

        monkeypatch.setattr(source, "message", broken)
        query = "SELECT ?m ?x { ?m <https://w3id.org/rosld/types/p/msg/T3#f0> ?x }"
        assert await endpoint.rows(query) == []
        assert await endpoint.rows(value(4)) == ["0.5"]
        monkeypatch.undo()
        source.tick()
        assert len(await endpoint.rows(query)) == 2

    run(scenario())


def test_what_the_source_raises_reaches_the_asker(make_source: Make, make_endpoint: Make, run: Make) -> None:
    async def scenario() -> None:
        source = make_source()
        endpoint = make_endpoint(source)

        async def unreachable() -> None:
            raise ConnectionRefusedError("the robot is gone")

        source.pause = unreachable
        with pytest.raises(ConnectionRefusedError):
            await endpoint.rows(value(3))
        source.pause = None
        assert await endpoint.rows(value(3)) == ["0.5"]

    run(scenario())


def test_of_a_thousand_changed_topics_a_query_that_names_ten_costs_only_these_ten(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        ten = " UNION ".join(f"{{ <http://robot/topics/t{n}> ros:latest ?m . ?m ?p ?x }}" for n in range(10))
        source = make_source(1000)
        endpoint = make_endpoint(source)
        await endpoint.text(ALL)
        source.tick()
        source.rendered.clear()
        assert len(await endpoint.rows(f"SELECT ?x {{ {ten} }}")) == 10 * source.fields
        assert sorted(source.rendered) == sorted(source.url(n) for n in range(10))

    run(scenario())


def test_a_wildcard_over_a_thousand_changed_topics_does_not_hold_up_the_loop(
    make_source: Make, make_endpoint: Make, run: Make
) -> None:
    async def scenario() -> None:
        source = make_source(1000, fields=15)
        endpoint = make_endpoint(source, interval=0.0)
        await endpoint.text(ALL)
        held: list[float] = []
        ended = asyncio.Event()

        async def watch() -> None:
            while not ended.is_set():
                begun = time.thread_time()
                await asyncio.sleep(0.001)
                held.append(time.thread_time() - begun)

        watcher = asyncio.ensure_future(watch())
        for _ in range(5):
            source.tick()
            await endpoint.text(ALL)
        ended.set()
        await watcher
        held.sort()
        assert held[len(held) * 9 // 10] < 0.05  # of this thread's own time, whatever else the machine does

    run(scenario())
