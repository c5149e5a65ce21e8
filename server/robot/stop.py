"""The stop: what moves is ended at once, and nothing that would move the robot passes until the stop is lifted."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, replace
from enum import Enum

from rosld.adapters.model import Message, MessageSchema, RosError
from rosld.ontology.lower import LoweringError, lowerer, parse_json
from rosld.server.auth.agent import Agent
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.holds import Hold, Holds
from rosld.server.robot.interlock import StopState
from rosld.server.robot.session import Session
from rosld.server.runtime.signals import Signal

_log = logging.getLogger("rosld")


class StepStatus(Enum):
    """What became of a step; the values are terms of the vocabulary."""

    PLANNED = "NotSent"
    RUNNING = "Running"
    DONE = "Succeeded"
    FAILED = "Failed"


@dataclass(frozen=True, slots=True)
class StopStep:
    """One thing that stops the robot: what it does in words, the URLs of what it is about, what became of it, why."""

    description: str
    affects: tuple[str, ...] = ()
    status: StepStatus = StepStatus.PLANNED
    words: str | None = None


@dataclass(frozen=True, slots=True)
class StopCommand:
    """What stops the robot: a `service` to call, or a `topic` to publish on, and the JSON of what it is told.

    What the JSON leaves out is ROS's default.
    """

    service: str | None = None
    topic: str | None = None
    content: str = "{}"


class SoftwareStop:
    """Stops one robot. `steps` are those of the latest stop while it lasts, else what a stop would do.

    `mapped` tells the steps that mappings ask for, each with the IRI of the complex resource that does.
    """

    def __init__(self, session: Session, holds: Holds, mapped: Callable[[], Iterable[tuple[StopCommand, str]]]) -> None:
        self._session = session
        self._holds = holds
        self._mapped = mapped
        self._steps: dict[str, StopStep] = {}
        self._running: set[asyncio.Task[None]] = set()
        self.revision = 0
        self.changes = Signal()

    @property
    def stop_state(self) -> StopState | None:
        """Who stopped the robot, when and why; None while it is not stopped."""
        return self._session.interlock.stop_state

    @property
    def is_usable(self) -> bool:
        """Whether the robot can be stopped and released from here."""
        return not self._session.settings.read_only and self._session.adapter.capabilities.writes

    @property
    def is_running(self) -> bool:
        """Whether steps of a stop are still being carried out."""
        return bool(self._running)

    @property
    def steps(self) -> tuple[StopStep, ...]:
        """What the stop did, or would do now."""
        if self.stop_state is not None:
            return tuple(self._steps.values())
        return tuple(StopStep(_words(each), self._touched(each, iri)) for each, iri in self._mapped())

    async def stop(self, by: Agent, reason: str | None) -> None:
        """Stop the robot, or do so again: who stopped it first is who stopped it.

        When this has run to its first await no write passes any more and every step has begun. Returns when all steps
        are done, at the latest after `call_deadline`.
        """
        session = self._session
        stop_state = self.stop_state or StopState(by.name, time.time_ns(), reason, session.space.stop)
        session.interlock.engage(stop_state)
        deadline = session.deadline(session.settings.call_deadline)
        space = session.space
        for each, iri in self._mapped():
            self._begin(_words(each), self._carried_out(each, deadline), *self._touched(each, iri))
        for hold, ended in self._holds.end_all(stop_state.words):
            self._begin(_end_of(hold), ended, space.hold(hold.id), space.topic(hold.topic))
        for goal in self._goals():
            canceled = session.goals.cancel(goal, deadline=deadline)
            words = f"cancel the goal {goal.id} of {goal.action}"
            self._begin(words, canceled, space.goal(goal.id), space.action(goal.action))
        _log.warning("%s.", stop_state.words.rstrip("."))
        self._revise()
        session.changes.emit()
        while self._running and session.deadline(0) < deadline:
            await asyncio.wait(self._running, timeout=deadline - session.deadline(0))

    def release(self, by: Agent) -> None:
        """Let writes pass again; nothing happens where the robot is not stopped."""
        if self.stop_state is None:
            return
        self._session.interlock.release()
        self._steps.clear()
        _log.warning("The stop was lifted by %s.", by.name)
        self._revise()
        self._session.changes.emit()

    def _touched(self, mapped: StopCommand, iri: str) -> tuple[str, ...]:
        """The URLs of what a step of a mapping is about: what it calls or publishes on, and the mapping."""
        space = self._session.space
        if mapped.service is not None:
            return space.service(mapped.service), iri
        assert mapped.topic is not None
        return space.topic(mapped.topic), iri

    def _goals(self) -> list[Goal]:
        return [goal for goal in self._session.goals.all() if goal.is_own and goal.is_cancelable]

    def _begin(self, does: str, work: Awaitable[None], *touches: str) -> None:
        self._steps[does] = StopStep(does, touches, StepStatus.RUNNING)
        task = asyncio.ensure_future(self._followed(does, work))
        self._running.add(task)
        task.add_done_callback(self._over)

    def _over(self, task: asyncio.Task[None]) -> None:
        self._running.discard(task)
        self._revise()

    async def _followed(self, does: str, work: Awaitable[None]) -> None:
        fate, words = StepStatus.DONE, None
        try:
            await work
        except (RosError, LoweringError, ValueError) as error:
            fate, words = StepStatus.FAILED, str(error)
            _log.error("while the robot was stopped: %s: %s", does, words)
        except Exception as error:
            fate, words = StepStatus.FAILED, "the server failed; its log says more"
            _log.exception("while the robot was stopped: %s", does, exc_info=error)
        if does in self._steps:
            self._steps[does] = replace(self._steps[does], status=fate, words=words)
            self._revise()

    async def _carried_out(self, mapped: StopCommand, deadline: float) -> None:
        """Call or publish what a mapping names, past the gate."""
        session, encoding = self._session, self._session.adapter.capabilities.encoding
        if mapped.service is not None:
            service = session.graph.services.get(mapped.service)
            if service is None or service.type is None:
                raise ValueError(f"there is no service {mapped.service} that can be called")
            called = await session.schemas.service(service.type)
            request = called.request.codec.encode(self._message(called.request, mapped), encoding)
            answer = await session.adapter.call_always(mapped.service, called.ref, request, deadline=deadline)
            response = called.response.codec.decode(answer, encoding)
            if getattr(response, "success", True) is False:
                raise ValueError(str(getattr(response, "message", "") or "it answered that it did not succeed"))
            return
        assert mapped.topic is not None
        topic = session.graph.topics.get(mapped.topic)
        if topic is None or topic.type is None:
            raise ValueError(f"there is no topic {mapped.topic} that can be published to")
        schema = await session.schemas.message(topic.type)
        data = schema.codec.encode(self._message(schema, mapped), encoding)
        await session.adapter.publish_always(mapped.topic, schema.ref, data, deadline=deadline)

    def _message(self, schema: MessageSchema, mapped: StopCommand) -> Message:
        return lowerer(schema, self._session.lifting).from_json(parse_json(mapped.content.encode()), defaults=True)

    def _revise(self) -> None:
        self.revision += 1
        self.changes.emit()

    async def wait_ended(self) -> None:
        """Returns when nothing of a stop is under way."""
        if self._running:
            await asyncio.wait(self._running)


def _words(mapped: StopCommand) -> str:
    does = f"call {mapped.service}" if mapped.service is not None else f"publish on {mapped.topic}"
    return does if mapped.content == "{}" else f"{does} with {mapped.content}"


def _end_of(hold: Hold) -> str:
    return f"end the hold {hold.id} on {hold.topic}"
