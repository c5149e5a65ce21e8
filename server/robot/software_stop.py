"""Software stop: ends all motion at once, and refuses writes that would move the robot until released."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from enum import Enum
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.model import Action, Graph, Kind, Message, MessageSchema, RosError, Topic
from rosld.ontology.body import parse_json
from rosld.ontology.lower import lowerer
from rosld.ontology.violations import LoweringError
from rosld.server.auth.rules import Agent
from rosld.server.http.problem import one_line
from rosld.server.receipts.audit import new_identifier, record_step
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.hold_store import Hold, Holds
from rosld.server.robot.interlock import StopState
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import commanded_topics, subscribers_of
from rosld.server.robot.write_policy import any_number_hint, takes_finite_numbers
from rosld.server.robot.zero_publisher import ReadyPublications, Receivers, ZeroPublisher
from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.runtime.tasks import Signal, loop_time
from rosld.shapes.command_numbers import require_finite_message

_log = logging.getLogger("rosld")
_NOTHING = "no topic of a velocity type has a subscriber (add others by --stop-zero), and no mapping defines a stop"
_ENDING_SECONDS = 1.0
"""Seconds to watch a goal that could not be canceled; its end may become known after the refusal."""


class StepStatus(Enum):
    """Outcome of a step; the values are terms of the vocabulary."""

    PLANNED = "NotSent"
    RUNNING = "Running"
    DONE = "Succeeded"
    FAILED = "Failed"


class StopStep(Struct, frozen=True):
    """A step of the stop: a description, the URLs of its subjects, the outcome, and the reason.

    `subscribers` is the number of receivers of a message, None without a message or before it is known. `sends` is
    False if the step sends the robot nothing.
    """

    description: str
    affects: tuple[str, ...] = ()
    status: StepStatus = StepStatus.PLANNED
    words: str | None = None
    subscribers: int | None = None
    sends: bool = True


class StopCommand(Struct, frozen=True):
    """A command that stops the robot: a `service` to call, or a `topic` to publish on, and the JSON of the message.

    Missing members have ROS's defaults.
    """

    service: str | None = None
    topic: str | None = None
    content: str = "{}"


class SoftwareStop:
    """The stop of one robot. `steps` are those of the current stop, or else those that a stop would perform now.

    `mapped` returns the steps that mappings define, each with the IRI of its complex resource. `is_at_rest` reads
    whether the target of such a step is at rest, because then a refused step is not a failure.
    """

    def __init__(
        self,
        session: Session,
        holds: Holds,
        mapped: Callable[[], Iterable[tuple[StopCommand, str]]],
        is_at_rest: Callable[[StopCommand], Awaitable[bool]],
    ) -> None:
        self._session = session
        self._holds = holds
        self._mapped = mapped
        self._is_at_rest = is_at_rest
        self._zero = ZeroPublisher(session)
        self._ready = ReadyPublications(session)
        self._steps: dict[str, StopStep] = {}
        self._running: set[asyncio.Task[None]] = set()
        self._late: set[asyncio.Task[None]] = set()
        self._count = 0
        self.revision = 0
        self.changes = Signal()

    @property
    def stop_state(self) -> StopState | None:
        """The stop with its agent, time and reason; None unless the robot is stopped."""
        return self._session.interlock.stop_state

    @property
    def is_usable(self) -> bool:
        """Whether the robot can be stopped and released from here."""
        return self.unusable_reason is None

    @property
    def unusable_reason(self) -> str | None:
        """Sentence on why the robot cannot be stopped and released from here, None if it can."""
        if self._session.settings.read_only:
            return "This server is read-only: it sends no commands to the robot, not even to stop."
        capabilities = self._session.adapter.capabilities
        return None if capabilities.writes else f"Nothing moves in a {capabilities.system}."

    @property
    def is_running(self) -> bool:
        """Whether steps of a stop are still running."""
        return bool(self._running)

    @property
    def steps(self) -> tuple[StopStep, ...]:
        """Steps of the current stop, or those of a stop now."""
        if self.stop_state is not None:
            return tuple(self._steps.values())
        graph, space = self._session.graph, self._session.space
        return (
            *(StopStep(_zero_on(topic.name), (space.topic(topic.name),)) for topic in self._commanded_topics(graph)),
            *(StopStep(_words(each), self._touched_urls(each, iri)) for each, iri in self._mapped()),
            *(StopStep(_end_of_all(each.name), (space.action(each.name),)) for each in self._ended_actions(graph)),
        )

    @property
    def warning(self) -> str | None:
        """Sentence on why the robot may still move although it is stopped, None if there is no sign of it."""
        steps = self.steps
        if self.stop_state is None:
            return None if steps else f"A stop would have no effect: {_NOTHING}."
        sending = [step for step in steps if step.sends]
        failed = sum(step.status is StepStatus.FAILED for step in sending)
        if self._running or (sending and not failed):
            return None
        if not sending:
            return f"The robot may still be moving, because no command to stop was sent: {_NOTHING}."
        return f"The robot may still be moving: {failed} of {len(sending)} steps to stop it failed."

    def start(self) -> None:
        """Advertise the topics of a stop in advance, if the settings require that."""
        if self._session.settings.stop_ready and self.is_usable:
            self._ready.start()

    async def stop(self, by: Agent, reason: str | None) -> None:
        """Stop the robot, or do so again; the first agent remains the one who stopped it.

        When this has run to its first await, writes are refused and every step has begun. Returns when all steps are
        done, at the latest after `call_deadline`.
        """
        session = self._session
        if is_dry_run():
            self.record_steps()
        end_dry_run(200)
        stop_state = self.stop_state or self._new_state(by, reason)
        session.interlock.engage(stop_state)
        self._count += 1
        deadline = loop_time() + session.settings.call_deadline
        graph, space = session.graph, session.space
        at_rest: Callable[[], Awaitable[bool]]
        commanded = self._commanded_topics(graph)
        for topic in commanded:
            self._begin(_zero_on(topic.name), self._publish_zero(topic), space.topic(topic.name))
        for each, iri in self._mapped():
            at_rest = partial(self._is_at_rest, each)
            self._begin(_words(each), self._send(each, deadline), *self._touched_urls(each, iri), is_at_rest=at_rest)
        silent = {topic.name for topic in commanded}  # the stop itself publishes zero there
        for hold, ended in self._holds.end_all(stop_state.sentence, silent):
            sends = hold.release_message is not None and hold.topic not in silent
            self._begin(_end_of(hold), ended, space.hold(hold.id), space.topic(hold.topic), sends=sends)
        ended_actions = {action.name for action in self._ended_actions(graph)}
        for name in sorted(ended_actions):
            canceled = session.adapter.cancel_goals(name, deadline=deadline)
            at_rest = partial(session.goals.wait_all_ended, name, seconds=_ENDING_SECONDS)
            self._begin(_end_of_all(name), canceled, space.action(name), is_at_rest=at_rest)
        for goal in self._goals():
            if goal.action not in ended_actions:
                canceled = session.goals.cancel(goal, deadline=deadline)
                at_rest = partial(session.goals.wait_ended, goal.id, seconds=_ENDING_SECONDS)
                urls = space.goal(goal.id), space.action(goal.action)
                self._begin(_cancel_of(goal), canceled, *urls, is_at_rest=at_rest)
        _log.warning("%s (%s).", stop_state.words, space.stop)
        self._revise()
        session.changes.emit()
        while self._running and loop_time() < deadline:
            await asyncio.wait(self._running, timeout=deadline - loop_time())
        if self.warning is not None:
            _log.error("%s", self.warning)

    def record_steps(self) -> None:
        """Record the steps that a stop would perform now, for a dry run."""
        space = self._session.space
        for step in self.steps:
            record_step(step.description, *step.affects)
        for hold in self._holds.all():
            record_step(_end_of(hold), space.hold(hold.id), space.topic(hold.topic))
        for goal in self._goals():
            record_step(_cancel_of(goal), space.goal(goal.id), space.action(goal.action))

    def _new_state(self, by: Agent, reason: str | None) -> StopState:
        return StopState(by.name, time.time_ns(), reason, self._session.space.stop, new_identifier())

    async def release(self, by: Agent) -> bool:
        """Accept writes again; return False if the robot was stopped again meanwhile."""
        end_dry_run()
        count = self._count
        await self._zero.withdraw()
        if count != self._count:
            return False
        if self.stop_state is None:
            return True
        self._session.interlock.release()
        self._steps.clear()
        _log.warning("The stop was lifted by %s.", by.name)
        self._revise()
        self._session.changes.emit()
        return True

    def _touched_urls(self, mapped: StopCommand, iri: str) -> tuple[str, ...]:
        """Return the URLs of the subjects of a mapped step: what it calls or publishes on, and the mapping."""
        space = self._session.space
        if mapped.service is not None:
            return space.service(mapped.service), iri
        assert mapped.topic is not None
        return space.topic(mapped.topic), iri

    def _commanded_topics(self, graph: Graph) -> Sequence[Topic]:
        return commanded_topics(graph, self._session.settings.stop_zero)

    def _ended_actions(self, graph: Graph) -> Sequence[Action]:
        """Return the actions whose goals are all canceled, regardless of their senders."""
        if self._session.settings.stop_cancels != "others":
            return ()
        return [action for action in graph.actions.values() if action.servers]

    def _goals(self) -> list[Goal]:
        return [goal for goal in self._session.goals.all() if goal.is_own and goal.is_cancelable]

    def _begin(
        self,
        does: str,
        work: Awaitable[Receivers | None],
        *touches: str,
        sends: bool = True,
        is_at_rest: Callable[[], Awaitable[bool]] | None = None,
    ) -> None:
        """Begin a step. If it fails, `is_at_rest` decides whether its target is at rest anyway, which is no failure."""
        self._steps[does] = StopStep(does, touches, StepStatus.RUNNING, sends=sends)
        task = asyncio.ensure_future(self._follow(does, work, is_at_rest))
        self._running.add(task)
        task.add_done_callback(self._over)

    def _over(self, task: asyncio.Task[None]) -> None:
        self._running.discard(task)
        self._revise()

    async def _follow(
        self, does: str, work: Awaitable[Receivers | None], is_at_rest: Callable[[], Awaitable[bool]] | None
    ) -> None:
        fate, words, reached = StepStatus.DONE, None, None
        try:
            reached = await work
            words = _missed_subscribers(reached)
        except (RosError, LoweringError, ValueError) as error:
            reason = one_line(str(error))  # may include text of the robot
            if is_at_rest is not None and await is_at_rest():
                words = f"it is already at rest: {reason}"
            else:
                fate, words = StepStatus.FAILED, reason
                _log.error("while the robot was stopped: %s: %s", does, words)
        except Exception as error:
            fate, words = StepStatus.FAILED, "the server failed; see its log"
            _log.exception("while the robot was stopped: %s", does, exc_info=error)
        if does in self._steps:
            count = None if reached is None else reached.subscribers
            self._steps[does] = replace(self._steps[does], status=fate, words=words, subscribers=count)
            self._revise()

    async def _publish_zero(self, topic: Topic) -> Receivers:
        begun = loop_time()
        try:
            return await self._zero.publish(topic)
        except (RosError, ValueError):
            late = asyncio.ensure_future(self._note_late(topic.name, begun))
            self._late.add(late)
            late.add_done_callback(self._late.discard)
            raise

    async def _note_late(self, topic: str, begun: float) -> None:
        """Mark the step of a topic as successful if zero reaches a subscriber later."""
        reached = await self._zero.wait_received_late(topic)
        step = self._steps.get(_zero_on(topic))
        if reached is None or step is None or step.status is not StepStatus.FAILED:
            return
        words = f"sent late, {loop_time() - begun:.1f} s after the stop"
        words = "; ".join(each for each in (words, _missed_subscribers(reached)) if each)
        self._steps[step.description] = replace(
            step, status=StepStatus.DONE, words=words, subscribers=reached.subscribers
        )
        _log.warning("while the robot was stopped: %s: %s", step.description, words)
        self._revise()

    async def _send(self, mapped: StopCommand, deadline: float) -> Receivers | None:
        """Call or publish what a mapping names, past the interlock."""
        session, encoding = self._session, self._session.adapter.capabilities.encoding
        if mapped.service is not None:
            service = session.graph.services.get(mapped.service)
            if service is None or service.type is None:
                raise ValueError(f"no service {mapped.service} can be called")
            called = await session.schemas.service(service.type)
            request = called.request.codec.encode(
                self._message(Kind.SERVICE, mapped.service, called.request, mapped), encoding
            )
            answer = await session.adapter.call_always(mapped.service, called.ref, request, deadline=deadline)
            response = called.response.codec.decode(answer, encoding)
            if getattr(response, "success", True) is False:
                raise ValueError(str(getattr(response, "message", "") or "the service reported failure"))
            return None
        assert mapped.topic is not None
        topic = session.graph.topics.get(mapped.topic)
        if topic is None or topic.type is None:
            raise ValueError(f"no topic {mapped.topic} can be published to")
        schema = await session.schemas.message(topic.type)
        data = schema.codec.encode(self._message(Kind.TOPIC, mapped.topic, schema, mapped), encoding)
        published = await session.adapter.publish_always(mapped.topic, schema.ref, data, deadline=deadline)
        if not published.matched:
            raise ValueError(f"{mapped.topic} had no subscriber to receive it")
        return Receivers(published.matched, subscribers_of(topic, session.graph))

    def _message(self, kind: Kind, name: str, schema: MessageSchema, mapped: StopCommand) -> Message:
        session = self._session
        message = lowerer(schema, session.lifting).from_json(parse_json(mapped.content.encode()), defaults=True)
        if takes_finite_numbers(session.graph, session.settings.allow_non_finite, kind, name, schema.ref.name):
            require_finite_message(schema, message, any_number_hint(name))
        return message

    def _revise(self) -> None:
        self.revision += 1
        self.changes.emit()

    async def wait_ended(self) -> None:
        """Wait until all steps of a stop have ended, and stop advertising."""
        await self._ready.stop()
        if self._running:
            await asyncio.wait(self._running)
        await self._zero.over()


def _words(mapped: StopCommand) -> str:
    does = f"call {mapped.service}" if mapped.service is not None else f"publish on {mapped.topic}"
    return does if mapped.content == "{}" else f"{does} with {mapped.content}"


def _zero_on(topic: str) -> str:
    return f"publish zero on {topic}"


def _missed_subscribers(reached: Receivers | None) -> str | None:
    """Return which subscribers were not reached, in words; None if all were."""
    if reached is None:
        return None
    missed = reached.expected - reached.subscribers
    return f"{missed} of {reached.expected} subscribers could not be reached" if missed > 0 else None


def _end_of_all(action: str) -> str:
    return f"cancel all goals of {action}"


def _cancel_of(goal: Goal) -> str:
    return f"cancel the goal {goal.id} of {goal.action}"


def _end_of(hold: Hold) -> str:
    return f"end the hold {hold.id} on {hold.topic}"
