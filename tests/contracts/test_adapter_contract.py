"""The adapter contract, rule by rule, on every adapter (`adapters/base.py`)."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any, TypeVar

import pytest

from rosld.adapters.base import Adapter, Subscription
from rosld.adapters.model import (
    ActionSchema,
    GoalEvent,
    GoalId,
    GoalStatus,
    Kind,
    Live,
    NotFound,
    Operation,
    Ref,
    Refused,
    RosError,
    Sample,
    Sent,
    ServiceSchema,
    Stale,
    TimedOut,
    TypeRef,
    UnknownType,
    Unreachable,
)
from tests.adapters.session import EventRecorder

Test = TypeVar("Test", bound=Callable[..., object])

PATIENCE = 30.0
DEADLINE = 10.0
"""Maximum duration in seconds, on a busy machine, of anything that should be immediate."""

WRITES = frozenset(Operation) - {Operation.SUBSCRIBE, Operation.GET_PARAMETER}


class Sink(EventRecorder):
    """A sink that records the events of an adapter, from any thread."""

    def told(self, goal: GoalId) -> list[GoalEvent]:
        """Return the reported states of a goal."""
        return [event for each, event in self.goals if each == goal]

    def statuses(self, goal: GoalId) -> list[GoalStatus]:
        """Return its statuses without repetitions, in order."""
        return list(dict.fromkeys(event.status for event in self.told(goal) if event.status is not None))


def soon(seconds: float = DEADLINE) -> float:
    """Return a deadline."""
    return asyncio.get_running_loop().time() + seconds


async def until(condition: Callable[[], object], seconds: float = PATIENCE) -> None:
    """Wait until a condition holds that no event reports."""
    deadline = soon(seconds)
    while not condition():
        assert asyncio.get_running_loop().time() < deadline, "it did not happen in time"
        await asyncio.sleep(0.01)


@asynccontextmanager
async def opened(robot: Any, sink: Sink | None = None) -> AsyncIterator[Adapter]:
    """Open the adapter of a robot and wait until its readable topic is in the graph."""
    adapter: Adapter = robot.adapter()
    await adapter.open(sink or Sink(), deadline=soon())
    try:
        yield adapter
    finally:
        await adapter.close()


async def first_samples(subscription: Subscription) -> Sequence[Sample]:
    """Return the first non-empty samples of a subscription."""
    return await change(subscription, ())


async def change(subscription: Subscription, known: Sequence[Sample]) -> Sequence[Sample]:
    """Return the samples of a subscription once they differ from `known`."""
    arrived = asyncio.Event()
    watch = subscription.watch(arrived.set)
    try:
        while (samples := subscription.latest()) is known or not samples:
            await asyncio.wait_for(arrived.wait(), PATIENCE)
            arrived.clear()
        return samples
    finally:
        watch.close()


async def message(adapter: Adapter, spoken: Any) -> tuple[TypeRef, bytes]:
    """Return the type and the bytes of a message that can be published."""
    schema = await adapter.schema(TypeRef(spoken.type), deadline=soon())
    assert not isinstance(schema, ServiceSchema)
    made = schema.codec.build(schema.ref.name, spoken.values)
    return schema.ref, schema.codec.encode(made, adapter.capabilities.encoding)


async def ask(adapter: Adapter, asked: Any, *, deadline: float | None = None) -> Any:
    """Return the response of the service."""
    said = adapter.graph.services.get(asked.service)
    schema = await adapter.schema(said.type if said and said.type else TypeRef(asked.type), deadline=soon())
    assert isinstance(schema, ServiceSchema)
    encoding = adapter.capabilities.encoding
    request = schema.request.codec.encode(schema.request.codec.build(schema.request.ref.name, asked.values), encoding)
    answer = await adapter.call(asked.service, schema.ref, request, deadline=soon() if deadline is None else deadline)
    return schema.response.codec.decode(answer, encoding)


async def act(adapter: Adapter, acted: Any, values: Mapping[str, object], *, deadline: float | None = None) -> GoalId:
    """Send a goal of the action, after the preparations."""
    for asked in acted.before:
        await ask(adapter, asked)
    return await send(adapter, acted.action, acted.type, values, deadline=deadline)


async def send(
    adapter: Adapter, action: str, type: str, values: Mapping[str, object], *, deadline: float | None = None
) -> GoalId:
    """Send a goal once the action accepts goals."""
    await until(lambda: Operation.SEND_GOAL in adapter.allows(Ref(Kind.ACTION, action)))
    schema = await action_schema(adapter, type)
    goal = schema.goal.codec.build(schema.goal.ref.name, values)
    data = schema.goal.codec.encode(goal, adapter.capabilities.encoding)
    return await adapter.send_goal(action, schema.ref, data, deadline=soon() if deadline is None else deadline)


async def action_schema(adapter: Adapter, type: str) -> ActionSchema:
    """Return the schema of an action type."""
    schema = await adapter.schema(TypeRef(type), deadline=soon())
    assert isinstance(schema, ActionSchema)
    return schema


def needs(*what: str) -> Callable[[Test], Test]:
    """Run a test only on robots with all of these (see conftest.py)."""

    def mark(test: Test) -> Test:
        test.needed = what  # type: ignore[attr-defined]
        return test

    return mark


# Opening and closing


async def test_an_open_adapter_has_a_live_graph_that_nobody_can_change(robot: Any) -> None:
    async with opened(robot) as adapter:
        await adapter.open(Sink(), deadline=soon())  # closing again is no error
        assert isinstance(adapter.graph.state, Live)
        await until(lambda: robot.readable in adapter.graph.topics)
        assert adapter.graph.topics[robot.readable].types
        graph: Any = adapter.graph
        assert adapter.graph is adapter.graph
        for names in (graph.nodes, graph.topics, graph.services, graph.parameters):
            with pytest.raises(TypeError):
                names["/x"] = None
        with pytest.raises(AttributeError):
            graph.revision = 7


async def test_closing_is_quick_and_calls_after_it_are_errors(robot: Any) -> None:
    await robot.adapter().close()  # which was never opened
    adapter = robot.adapter()
    await adapter.open(Sink(), deadline=soon())
    await first_samples(await adapter.subscribe(robot.readable))
    await asyncio.wait_for(adapter.close(), 30)
    await adapter.close()
    with pytest.raises(RosError) as caught:
        await adapter.call("/nothing", TypeRef("std_srvs/srv/Trigger"), b"", deadline=soon(1))
    assert caught.value.sent is Sent.NO


@needs("nowhere")
async def test_a_source_that_is_not_there_is_told_in_a_sentence_and_nothing_was_sent(robot: Any) -> None:
    adapter = robot.nowhere()
    try:
        await adapter.open(Sink(), deadline=soon(3))
    except (Unreachable, NotFound) as error:
        said, sent = error.sentence, error.sent
    else:  # rosld waits for a robot that is off
        assert isinstance(adapter.graph.state, Stale)
        said, sent = adapter.graph.state.why, Sent.NO
    assert sent is Sent.NO
    assert len(said) > 10
    assert "\n" not in said
    await adapter.close()


# Reading


async def test_a_topic_is_read_with_the_bytes_owned_and_decoded_by_the_samples_own_schema(robot: Any) -> None:
    async with opened(robot) as adapter:
        subscription = await adapter.subscribe(robot.readable)
        first = await first_samples(subscription)
        for sample in first:
            assert type(sample.data) is bytes
            assert sample.schema.hash is not None
            schema = await adapter.schema(sample.schema, deadline=soon())
            assert not isinstance(schema, ServiceSchema)
            decoded = schema.codec.decode(sample.data, sample.encoding)
            assert schema.codec.encode(decoded, sample.encoding) == sample.data
            assert sample.publisher in adapter.graph.nodes or sample.publisher == ""
            age = adapter.age_ns(sample)
            assert 0 <= age < PATIENCE * 1e9
            await until(lambda each=sample, before=age: adapter.age_ns(each) > before)
        second = await change(subscription, subscription.latest())
        old = {sample.publisher: sample for sample in first}
        newer = [sample for sample in second if sample.publisher in old]
        assert newer
        for sample in newer:
            known = old[sample.publisher]
            assert (sample.epoch, sample.sequence) >= (known.epoch, known.sequence)
            assert sample.received_ns >= known.received_ns
        assert second != first


async def test_the_very_same_sequence_comes_back_while_nothing_new_arrived(robot: Any) -> None:
    async with opened(robot) as adapter:
        subscription = await adapter.subscribe(robot.readable)
        seen = await first_samples(subscription)
        same = 0
        for _ in range(200):
            again = subscription.latest()
            assert again is seen or again != seen
            same += again is seen
            seen = again
        assert same > 100


async def test_a_deeper_subscription_shows_the_last_few_oldest_first(robot: Any) -> None:
    async with opened(robot) as adapter:
        deep = await adapter.subscribe(robot.readable, depth=3)
        await first_samples(deep)
        await until(lambda: len(deep.latest()) >= 3)
        samples = deep.latest()
        publisher = samples[-1].publisher
        of_one = [sample.sequence for sample in samples if sample.publisher == publisher]
        assert of_one == list(range(of_one[0], of_one[0] + 3))


async def test_a_watch_wakes_on_the_loop_for_new_samples_only_and_not_once_closed(robot: Any) -> None:
    async with opened(robot) as adapter:
        subscription = await adapter.subscribe(robot.readable)
        await first_samples(subscription)
        woken: list[int] = []
        closed = subscription.watch(lambda: pytest.fail("this watch is closed"))
        closed.close()
        closed.close()
        first = subscription.latest()
        subscription.watch(lambda: woken.append(threading.get_ident()))
        await until(lambda: subscription.latest()[-1].sequence >= first[-1].sequence + 3)
        arrived = subscription.latest()[-1].sequence - first[-1].sequence
        assert 1 <= len(woken) <= arrived + 1
        assert set(woken) == {threading.get_ident()}


async def test_subscriptions_are_counted_so_that_closing_one_leaves_the_other(robot: Any) -> None:
    async with opened(robot) as adapter:
        one, two = [await adapter.subscribe(robot.readable) for _ in range(2)]
        await first_samples(one)
        one.close()
        one.close()
        known = await first_samples(two)
        assert await change(two, known)
        missing = await adapter.subscribe("/no/such/topic")
        assert list(missing.latest()) == []
        assert missing.latest() is missing.latest()
        missing.watch(lambda: None).close()
        missing.close()
        assert "/no/such/topic" not in adapter.graph.topics


@needs("trace")
async def test_reading_leaves_no_trace(robot: Any) -> None:
    before = robot.trace()
    async with opened(robot) as adapter:
        subscription = await adapter.subscribe(robot.readable)
        for sample in await first_samples(subscription):
            await adapter.schema(sample.schema, deadline=soon())
        await adapter.get_parameters(["/no/such/parameter"], deadline=soon())
        assert robot.trace() == before
    assert robot.trace() == before


@needs("trace", "writable")
async def test_a_published_topic_leaves_no_trace_once_closed(robot: Any) -> None:
    before = robot.trace()
    async with opened(robot) as adapter:
        ref, data = await message(adapter, robot.writable)
        await adapter.publish(robot.writable.topic, ref, data, deadline=soon())
        assert robot.trace() != before
    assert robot.trace() == before


# Schemas


async def test_a_schema_is_found_by_name_and_by_name_and_hash_or_unknown_by_name(robot: Any) -> None:
    unknown = (TypeRef("no_such_msgs/msg/Thing"), TypeRef("std_msgs/msg/String", "0" * 32), TypeRef("../../etc/passwd"))
    async with opened(robot) as adapter:
        await first_samples(await adapter.subscribe(robot.readable))
        used = adapter.graph.topics[robot.readable].types[0]
        by_name = await adapter.schema(TypeRef(used.name), deadline=soon())
        assert by_name.ref.hash is not None
        assert (await adapter.schema(by_name.ref, deadline=soon())).ref == by_name.ref
        assert used.name in {ref.name for ref in adapter.known_types()}
        for ref in unknown:
            with pytest.raises(UnknownType) as caught:
                await adapter.schema(ref, deadline=soon(2))
            assert ref.name in caught.value.sentence


# Publishing


@needs("writable")
async def test_what_rosld_publishes_is_its_newest_sample_before_publish_returns(robot: Any) -> None:
    async with opened(robot) as adapter:
        before = await adapter.subscribe(robot.writable.topic)
        ref, data = await message(adapter, robot.writable)
        await adapter.advertise(robot.writable.topic, ref, deadline=soon())
        await adapter.advertise(robot.writable.topic, ref, deadline=soon())
        sequences = []
        for _ in range(5):
            published = await adapter.publish(robot.writable.topic, ref, data, deadline=soon(0.1))
            assert published.matched >= 1, "what was advertised beforehand waits for nobody"
            for subscription in (before, await adapter.subscribe(robot.writable.topic)):
                own = [each for each in subscription.latest() if each.publisher == adapter.graph.own_node]
                assert [(each.data, each.schema) for each in own] == [(data, ref)]
            sequences.append(own[0].sequence)
        assert sequences == list(range(sequences[0], sequences[0] + 5))


@needs("writable")
async def test_rosld_is_in_the_graph_only_while_it_advertises_and_the_sink_is_told(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        before, own = adapter.graph, adapter.graph.own_node
        assert own not in before.nodes
        ref, data = await message(adapter, robot.writable)
        await adapter.publish(robot.writable.topic, ref, data, deadline=soon())
        await until(lambda: own in adapter.graph.nodes)
        assert own in {each.node for each in adapter.graph.topics[robot.writable.topic].publishers}
        assert adapter.graph.revision > before.revision
        assert own not in before.nodes
        await until(lambda: sink.graphs and sink.graphs[-1] is adapter.graph)
        revisions = [graph.revision for graph in sink.graphs]
        assert revisions == sorted(set(revisions))
        await adapter.unadvertise(robot.writable.topic)
        await until(lambda: own not in adapter.graph.nodes)
        with pytest.raises(NotFound):
            await adapter.unadvertise(robot.writable.topic)


@needs("writable")
async def test_a_topic_that_is_not_there_is_created_by_publishing_and_matches_nobody(robot: Any) -> None:
    async with opened(robot) as adapter:
        assert adapter.capabilities.creates_topics
        with pytest.raises(UnknownType) as caught:
            await adapter.publish("/brand/new", TypeRef("no_such_msgs/msg/Thing"), b"", deadline=soon(1))
        assert caught.value.sent is Sent.NO
        assert "/brand/new" not in adapter.graph.topics
        ref, data = await message(adapter, robot.writable)
        published = await adapter.publish("/brand/new", ref, data, deadline=soon(0.5))
        assert published.matched == 0
        await until(lambda: "/brand/new" in adapter.graph.topics)
        assert adapter.graph.topics["/brand/new"].types == (ref,)
        assert [each.data for each in (await adapter.subscribe("/brand/new")).latest()] == [data]
        await adapter.unadvertise("/brand/new")
        await until(lambda: "/brand/new" not in adapter.graph.topics)


# Services


@needs("answering")
async def test_a_service_answers_and_is_not_called_after_the_deadline(robot: Any) -> None:
    async with opened(robot) as adapter:
        await until(lambda: robot.answering.service in adapter.graph.services)
        response = await ask(adapter, robot.answering)
        assert {name: getattr(response, name) for name in robot.answering.response} == robot.answering.response
        with pytest.raises(TimedOut) as caught:
            await ask(adapter, robot.answering, deadline=soon(-1))
        assert caught.value.sent is Sent.NO


async def test_a_service_that_is_not_there_is_not_found_and_nothing_was_sent(robot: Any) -> None:
    async with opened(robot) as adapter:
        with pytest.raises(NotFound) as caught:
            await adapter.call("/no/such/service", TypeRef("std_srvs/srv/Trigger"), b"", deadline=soon())
        assert "/no/such/service" in caught.value.sentence
        assert caught.value.sent is Sent.NO


@needs("raising")
async def test_what_a_node_raises_is_refused_in_its_words(robot: Any) -> None:
    async with opened(robot) as adapter:
        await until(lambda: robot.raising.service in adapter.graph.services)
        with pytest.raises(Refused) as caught:
            await ask(adapter, robot.raising)
        assert robot.raising.words in (caught.value.words or "")
        assert caught.value.sent is Sent.YES


@needs("hanging")
async def test_a_service_that_hangs_is_given_up_at_the_deadline_and_holds_up_nobody(robot: Any) -> None:
    async with opened(robot) as adapter:
        await until(lambda: robot.hanging.service in adapter.graph.services)
        began = time.monotonic()
        hanging = asyncio.create_task(ask(adapter, robot.hanging, deadline=soon(1)))
        await ask(adapter, robot.answering)
        assert not hanging.done()
        with pytest.raises(TimedOut) as caught:
            await hanging
        assert time.monotonic() - began > 0.9
        assert caught.value.sent in (Sent.MAYBE, Sent.YES)
        task = asyncio.create_task(ask(adapter, robot.hanging))
        await ask(adapter, robot.answering)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert await ask(adapter, robot.answering), "to give up waiting harms nothing"


# Actions


@needs("acting")
async def test_a_goal_is_pursued_with_feedback_until_it_succeeds_with_its_result(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        goal = await act(adapter, robot.acting, robot.acting.quick)
        assert goal.action == robot.acting.action
        await until(lambda: any(event.result is not None for event in sink.told(goal)))
        await until(lambda: GoalStatus.SUCCEEDED in sink.statuses(goal))
        told, schema = sink.told(goal), await action_schema(adapter, robot.acting.type)
        assert all(event.own for event in told)
        assert [status for status in sink.statuses(goal) if status.is_final] == [GoalStatus.SUCCEEDED]
        encoding = adapter.capabilities.encoding
        feedback = [schema.feedback.codec.decode(one.feedback, encoding) for one in told if one.feedback]
        results = [schema.result.codec.decode(one.result, encoding) for one in told if one.result]
        assert feedback
        assert len(results) == 1


@needs("acting")
async def test_a_goal_is_canceled_on_request_and_an_unknown_one_is_not(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        goal = await act(adapter, robot.acting, robot.acting.lasting)
        await until(lambda: any(event.feedback for event in sink.told(goal)))
        with pytest.raises(NotFound):
            await adapter.cancel_goal(GoalId(goal.action, ""), deadline=soon())
        for id in ("no such goal", "0" * 32):  # no system may accept it for every goal
            with suppress(NotFound, Refused):
                await adapter.cancel_goal(GoalId(goal.action, id), deadline=soon())
        before = len(sink.told(goal))
        await until(lambda: sum(event.feedback is not None for event in sink.told(goal)[before:]) > 1)
        assert GoalStatus.CANCELING not in sink.statuses(goal)
        await adapter.cancel_goal(goal, deadline=soon())
        await until(lambda: GoalStatus.CANCELED in sink.statuses(goal))
        assert sink.statuses(goal)[-1] is GoalStatus.CANCELED


@asynccontextmanager
async def goals_of_another(robot: Any, sink: Sink) -> AsyncIterator[Callable[[], set[GoalId]]]:
    """Let another client send a goal; return the goals pursued since, at least one."""
    known = {goal for goal, _ in sink.goals}
    end = await asyncio.to_thread(robot.other)

    def pursued() -> set[GoalId]:
        """Events may include the ends of earlier goals: these have feedback."""
        return {goal for goal, event in sink.goals if event.feedback} - known

    try:
        await until(pursued)
        yield pursued
    finally:
        await asyncio.to_thread(end)


@needs("acting", "other")
async def test_goals_of_others_are_followed_and_canceled_one_by_one_and_together(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        await until(lambda: robot.acting.action in adapter.graph.actions)
        watch = await adapter.follow_goals(robot.acting.action, deadline=soon(2.0))
        async with goals_of_another(robot, sink) as pursued:
            [goal] = pursued()
            assert not any(event.own for event in sink.told(goal))
            await adapter.cancel_goal(goal, deadline=soon())
            await until(lambda: GoalStatus.CANCELED in sink.statuses(goal))
        async with goals_of_another(robot, sink) as pursued:
            await adapter.cancel_goals(robot.acting.action, deadline=soon())
            await until(lambda: all(GoalStatus.CANCELED in sink.statuses(goal) for goal in pursued()))
        watch.close()
        watch.close()


@needs("acting")
async def test_all_goals_of_an_action_are_canceled_together_and_none_is_no_failure(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        goal = await act(adapter, robot.acting, robot.acting.lasting)
        await until(lambda: any(event.feedback for event in sink.told(goal)))
        await adapter.cancel_goals(goal.action, deadline=soon())
        await until(lambda: GoalStatus.CANCELED in sink.statuses(goal))
        await adapter.cancel_goals(goal.action, deadline=soon())
        with pytest.raises(NotFound):
            await adapter.cancel_goals("/no/such", deadline=soon())


@needs("rejecting")
async def test_a_goal_that_is_rejected_is_refused_and_never_told_of_as_ours(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        with pytest.raises(Refused, match=robot.rejecting[0]):
            await send(adapter, *robot.rejecting)
        assert not any(event.own for _, event in sink.goals)


@needs("acting")
async def test_what_is_no_action_and_what_is_of_another_type_is_refused_and_nothing_was_sent(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        action, type = robot.acting.action, TypeRef(robot.acting.type)
        await until(lambda: action in adapter.graph.actions)
        assert adapter.allows(Ref(Kind.ACTION, "/no/such")) == frozenset()
        tried = [
            (NotFound, adapter.send_goal("/no/such", type, b"", deadline=soon())),
            (NotFound, adapter.cancel_goal(GoalId("/no/such", "0" * 32), deadline=soon())),
            (NotFound, adapter.follow_goals("/no/such", deadline=soon())),
            (Refused, adapter.send_goal(action, TypeRef("odd/action/Other"), b"", deadline=soon())),
        ]
        for kind, attempt in tried:
            with pytest.raises(kind) as caught:
                await attempt
            assert caught.value.sent is Sent.NO
        assert not any(event.own for _, event in sink.goals)


# Parameters


@needs("parameter")
async def test_parameters_of_a_name_service_are_created_read_changed_and_deleted(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        assert adapter.capabilities.parameter_trees
        name = "/contract/value"
        assert await adapter.get_parameters([name], deadline=soon()) == {}
        for value in (1, "two", 3.5, True, ["a", 1], {"deep": {"er": "x"}}):
            await adapter.set_parameters({name: value}, deadline=soon())
            assert await adapter.get_parameters([name], deadline=soon()) == {name: value}
        await until(lambda: any(name.startswith(told.rstrip("/")) for told in sink.parameters))
        await until(lambda: f"{name}/deep/er" in adapter.graph.parameters)
        bad: Any = {"/contract/good": 1, "/contract/bad": 2**40}
        with pytest.raises(Refused, match="/contract/bad"):
            await adapter.set_parameters(bad, deadline=soon())
        assert await adapter.get_parameters(list(bad), deadline=soon()) == {}
        await adapter.delete_parameters([name], deadline=soon())
        assert await adapter.get_parameters([name], deadline=soon()) == {}
        await until(lambda: not any(each.startswith(name) for each in adapter.graph.parameters))
        await adapter.delete_parameters(["/contract"], deadline=soon())
        known, value = robot.parameter
        tree: Any = (await adapter.get_parameters(["/"], deadline=soon()))["/"]
        for step in known.strip("/").split("/"):
            tree = tree[step]
        assert tree == value


@needs("owner")
async def test_parameters_of_a_node_are_created_read_changed_and_deleted(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        assert not adapter.capabilities.parameter_trees
        await until(lambda: Operation.SET_PARAMETER in adapter.allows(Ref(Kind.PARAMETER, f"{robot.owner}/x")))
        name = f"{robot.owner}/contract.value"
        assert await adapter.get_parameters([name], deadline=soon()) == {}
        for value in (1, -(2**63), "two", 1.0, True, b"\x00\xff", [1, 2], [1.0], [True], ["a", ""]):
            await adapter.set_parameters({name: value}, deadline=soon())
            read = (await adapter.get_parameters([name], deadline=soon()))[name]
            assert (read, repr(read)) == (value, repr(value))
            assert adapter.graph.parameters[name].node == robot.owner
        await until(lambda: name in sink.parameters)
        for value in (2**63, {"a": 1}, [1, "a"], [[1]]):
            bad: Any = {f"{robot.owner}/good": 1, f"{robot.owner}/bad": value}
            with pytest.raises(Refused, match=f"{robot.owner}/bad") as caught:
                await adapter.set_parameters(bad, deadline=soon())
            assert caught.value.sent is Sent.NO
            assert await adapter.get_parameters(list(bad), deadline=soon()) == {}
        tree: Any = (await adapter.get_parameters([robot.owner], deadline=soon()))[robot.owner]
        assert tree["contract.value"] == ["a", ""]
        await adapter.delete_parameters([name], deadline=soon())
        assert await adapter.get_parameters([name], deadline=soon()) == {}
        await until(lambda: name not in adapter.graph.parameters)


@needs("guarded")
async def test_what_a_node_refuses_is_told_in_its_words_and_none_of_what_came_with_it_is_set(robot: Any) -> None:
    async with opened(robot) as adapter:
        name, bad, words = robot.guarded
        await until(lambda: name in adapter.graph.parameters)
        node = adapter.graph.parameters[name].node
        others = [each.name for each in adapter.graph.parameters.values() if each.node == node]
        before = await adapter.get_parameters(others, deadline=soon())
        changed = {each: f"{value}?" for each, value in before.items() if isinstance(value, str)}
        assert changed
        with pytest.raises(Refused, match=name) as caught:
            await adapter.set_parameters({**changed, name: bad}, deadline=soon())
        assert caught.value.words == words
        assert caught.value.sent is Sent.YES
        assert await adapter.get_parameters(others, deadline=soon()) == before


async def test_deleting_a_parameter_that_is_not_there_is_not_found(robot: Any) -> None:
    async with opened(robot) as adapter:
        with pytest.raises(NotFound, match="/no/such/parameter"):
            await adapter.delete_parameters(["/no/such/parameter"], deadline=soon())


# What is allowed


async def test_what_is_allowed_agrees_with_the_capabilities_and_unknown_things_allow_their_creation(robot: Any) -> None:
    async with opened(robot) as adapter:
        await until(lambda: robot.readable in adapter.graph.topics)
        can = adapter.capabilities
        graph = adapter.graph
        known = [
            *(Ref(Kind.TOPIC, name) for name in graph.topics),
            *(Ref(Kind.SERVICE, name) for name in graph.services),
            *(Ref(Kind.ACTION, name) for name in graph.actions),
            *(Ref(Kind.PARAMETER, name) for name in graph.parameters),
            *(Ref(Kind.NODE, name) for name in graph.nodes),
        ]
        for ref in known:
            allowed = adapter.allows(ref)
            assert can.writes or not allowed & WRITES
            assert (Operation.SUBSCRIBE in allowed) == (ref.kind is Kind.TOPIC)
            if ref.kind is Kind.SERVICE and graph.services[ref.name].uncallable is None:
                assert allowed == {Operation.CALL}
            if ref.kind is Kind.ACTION:
                action = graph.actions[ref.name]
                assert (Operation.SEND_GOAL in allowed) == (action.unusable is None and bool(action.servers))
            if ref.kind is Kind.PARAMETER:
                assert Operation.GET_PARAMETER in allowed
        assert Operation.SUBSCRIBE in adapter.allows(Ref(Kind.TOPIC, robot.readable))
        topic = adapter.allows(Ref(Kind.TOPIC, "/no/such"))
        assert topic == (frozenset({Operation.PUBLISH}) if can.creates_topics else frozenset())
        assert adapter.allows(Ref(Kind.SERVICE, "/no/such")) == frozenset()
        assert adapter.allows(Ref(Kind.NODE, "/no/such")) == frozenset()
        assert adapter.allows(Ref(Kind.PARAMETER, "/no/such")) <= {Operation.SET_PARAMETER}


@needs("read_only")
async def test_a_system_that_cannot_be_written_to_refuses_every_write(robot: Any) -> None:
    async with opened(robot) as adapter:
        assert not adapter.capabilities.writes
        kind = adapter.graph.topics[robot.readable].types[0]
        writes = [
            adapter.publish(robot.readable, kind, b"", deadline=soon()),
            adapter.set_parameters({"/x": 1}, deadline=soon()),
            adapter.call("/x", TypeRef("std_srvs/srv/Trigger"), b"", deadline=soon()),
            adapter.delete_parameters(["/x"], deadline=soon()),
            adapter.unadvertise(robot.readable),
            adapter.send_goal("/x", TypeRef("rosld_aircraft/action/Fly"), b"", deadline=soon()),
            adapter.cancel_goal(GoalId("/x", "0" * 32), deadline=soon()),
        ]
        for write in writes:
            with pytest.raises((Refused, NotFound)) as caught:
                await write
            assert caught.value.sent is Sent.NO


# Patience


async def test_nothing_blocks_the_loop(robot: Any) -> None:
    """A blocking call is measured every time; a busy machine delays the loop occasionally."""

    async def longest_gap() -> float:
        gaps = [0.0]

        async def beat() -> None:
            last = time.monotonic()
            while True:
                await asyncio.sleep(0.005)
                now = time.monotonic()
                gaps.append(now - last)
                last = now

        beating = asyncio.create_task(beat())
        async with opened(robot) as adapter:
            subscription = await adapter.subscribe(robot.readable)
            for _ in range(5):
                await change(subscription, subscription.latest())
            if robot.answering is not None:
                await ask(adapter, robot.answering)
            if robot.writable is not None:
                ref, data = await message(adapter, robot.writable)
                await adapter.publish(robot.writable.topic, ref, data, deadline=soon())
                await adapter.publish("/brand/new", ref, data, deadline=soon(0.3))
            if robot.hanging is not None:
                with pytest.raises(TimedOut):
                    await ask(adapter, robot.hanging, deadline=soon(0.3))
        beating.cancel()
        return max(gaps)

    async with opened(robot) as warm:  # imports and compiled types cost time once per process
        await warm.schema(warm.known_types()[0], deadline=soon())
    gaps: list[float] = []
    while not gaps or (min(gaps) >= 0.25 and len(gaps) < 5):
        gaps.append(await longest_gap())
    assert min(gaps) < 0.25, gaps


@needs("vanish")
async def test_a_system_that_vanishes_leaves_a_stale_graph_and_its_return_is_noticed(robot: Any) -> None:
    sink = Sink()
    async with opened(robot, sink) as adapter:
        await until(lambda: robot.readable in adapter.graph.topics)
        subscription = await adapter.subscribe(robot.readable)
        await first_samples(subscription)
        await asyncio.to_thread(robot.vanish)
        try:
            await until(lambda: isinstance(adapter.graph.state, Stale), 60)
            assert robot.readable in adapter.graph.topics
            assert isinstance(sink.graphs[-1].state, Stale)
            assert subscription.latest()
        finally:
            await asyncio.to_thread(robot.come_back)
        await until(lambda: isinstance(adapter.graph.state, Live), 60)
        await until(lambda: robot.readable in adapter.graph.topics, 60)
        assert await change(subscription, subscription.latest())


# Recordings


@needs("read_only")
async def test_recordings_are_read_message_by_message_in_recorded_order(robot: Any) -> None:
    async with opened(robot) as adapter:
        assert adapter.recordings
        for name, recording in adapter.recordings.items():
            assert recording.name == name
            assert recording.count == sum(topic.count for topic in recording.topics.values())
            with pytest.raises(NotFound, match=str(recording.count)):
                recording.message(recording.count)
            with pytest.raises(NotFound):
                recording.message(-1)
            times = []
            for index, recorded in enumerate(recording.messages()):
                assert recorded.index == index
                assert recorded == recording.message(index)
                times.append(recorded.sample.received_ns)
            assert len(times) == recording.count
            assert times == sorted(times)
            assert (times[0], times[-1]) == (recording.start_ns, recording.end_ns)
