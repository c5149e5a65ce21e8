"""Reader of the sources of properties: topics, getter services and parameters."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rosld.adapters.model import Message, MessageSchema, ParameterValue, Refused, RosError, Sample, TimedOut
from rosld.ontology.parameters import parameter_json
from rosld.server.hypermedia.catalogue import IDLE, Getter, GoalPart, GoalSource
from rosld.server.hypermedia.value import MessageValue, StoredValue, Value, refusal_text
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.session import Session
from rosld.server.robot.topic_view import TopicView

_log = logging.getLogger("rosld.hypermedia")


class ReadResult(NamedTuple):
    """The result of a read: a value, or the reason for its absence; both are None if there is no value yet.

    `words` are the robot's own words about a failure.
    """

    value: Value | None
    failure: str | None
    read_ns: int | None
    words: str | None = None


NO_VALUE = ReadResult(None, None, None)


class TopicLook(NamedTuple):
    """The result of reading a topic: its view, and the schema of the newest message or why that is unknown."""

    view: TopicView
    schema: MessageSchema | None = None
    failure: str | None = None


def timeout_message(name: str, seconds: float) -> str:
    """Return the failure of a source that did not answer in time."""
    return f"{name} did not respond within {round(seconds, 1):g} s"


def decode_value(topic: str, sample: Sample, schema: MessageSchema, origin: str) -> ReadResult:
    """Return the value in a sample of a topic."""
    try:
        message = schema.codec.decode(sample.data, sample.encoding)
    except ValueError as error:
        return ReadResult(None, f"the latest message of {topic} cannot be read: {error}", sample.received_ns)
    return ReadResult(MessageValue(schema, message, schema.type.fields, origin), None, sample.received_ns)


def part_of_goal(source: GoalSource, goal: Goal | None) -> object:
    """Return the part of a goal that a source shows, an object that stays the same when other parts change."""
    if goal is None:
        return None
    parts = {
        GoalPart.STATUS: goal.status,
        GoalPart.GOAL: goal.goal,
        GoalPart.FEEDBACK: goal.feedback,
        GoalPart.RESULT: goal.result,
    }
    return parts[source.part]


def goal_value(source: GoalSource, goal: Goal | None, origin: str) -> ReadResult:
    """Return the value of a goal's part, or the status of no goal; None before the first message."""
    if source.part is GoalPart.STATUS:
        word, changed_ns = (IDLE, None) if goal is None else (goal.status.value, goal.updated_ns)
        return ReadResult(StoredValue(word), None, changed_ns)
    if goal is None:
        return NO_VALUE
    feedback = goal.feedback
    messages: Mapping[GoalPart, tuple[Message | None, int | None]] = {
        GoalPart.GOAL: (goal.goal, goal.created_ns),
        GoalPart.FEEDBACK: (None, None) if feedback is None else (feedback.message, feedback.received_ns),
        GoalPart.RESULT: (goal.result, goal.ended_ns),
    }
    message, at_ns = messages[source.part]
    if message is None or source.schema is None:
        return ReadResult(None, goal.unreadable, at_ns)
    return ReadResult(MessageValue(source.schema, message, source.schema.type.fields, origin), None, at_ns)


class SourceReader:
    """Reader of the sources of one robot. Its methods do not raise: a failure is a result that names the source."""

    def __init__(self, session: Session) -> None:
        self._adapter = session.adapter.inner  # reads are no steps of a write, and pass a stop
        self._topics = session.topics
        self._schemas = session.schemas
        self._patience = session.settings.call_deadline

    async def read_topic(self, topic: str) -> TopicLook:
        """Return the result of reading a topic, after a short wait for its first message."""
        view = TopicView()
        try:
            view = await self._topics.read(topic)
            newest = view.newest
            return TopicLook(view) if newest is None else TopicLook(view, await self._schemas.message(newest.schema))
        except Exception as error:
            return TopicLook(view, None, self._failure(topic, error)[0])

    async def call_getter(self, getter: Getter, origin: str) -> ReadResult:
        """Return the result of calling a getter, within `call_deadline` seconds."""
        response = getter.schema.response
        try:
            message = await self._answer(getter)
        except Exception as error:
            failure, words = self._failure(getter.name, error)
            return ReadResult(None, failure, time.time_ns(), words)
        words = refusal_text(response, message, getter.fields)
        if words is not None:
            return ReadResult(None, f"{getter.name} refused", time.time_ns(), words or None)
        return ReadResult(MessageValue(response, message, getter.fields, origin), None, time.time_ns())

    async def _answer(self, getter: Getter) -> Message:
        """Return the response of a getter. Raises RosError, TimeoutError, and ValueError for undecodable bytes."""
        encoding, schema = self._adapter.capabilities.encoding, getter.schema
        request = schema.request.codec.encode(schema.request.codec.build(schema.request.ref.name, {}), encoding)
        deadline = asyncio.get_running_loop().time() + self._patience
        pending = self._adapter.call(getter.name, schema.ref, request, deadline=deadline)
        return schema.response.codec.decode(await asyncio.wait_for(pending, self._patience), encoding)

    async def read_parameters(self, names: Sequence[str]) -> Mapping[str, ReadResult]:
        """Return the values of parameters, fetched together within `call_deadline` seconds."""
        deadline = asyncio.get_running_loop().time() + self._patience
        try:
            pending = self._adapter.get_parameters(names, deadline=deadline)
            values = await asyncio.wait_for(pending, self._patience)
        except Exception as error:
            failures = {name: self._failure(name, error) for name in names}
            return {name: ReadResult(None, why, time.time_ns(), words) for name, (why, words) in failures.items()}
        return {
            name: _parameter_result(name, values[name]) if name in values else _missing_parameter(name)
            for name in names
        }

    def _failure(self, name: str, error: Exception) -> tuple[str, str | None]:
        """Return the reason why a source cannot be read, and the robot's own words."""
        match error:
            case TimedOut() | asyncio.TimeoutError() | TimeoutError():
                return timeout_message(name, self._patience), None
            case Refused():
                return (f"{name} refused", error.words) if error.words else (f"{name} refused: {error.sentence}", None)
            case RosError():
                return f"{name} cannot be read: {error.sentence}", error.words
            case ValueError():
                return f"the response of {name} cannot be read: {error}", None
        _log.exception("%s cannot be read", name, exc_info=error)
        return f"{name} cannot be read", None


def _parameter_result(name: str, value: ParameterValue) -> ReadResult:
    try:
        parameter_json(value)
    except (ValueError, TypeError) as error:  # nested too deeply, or a string that is not valid Unicode
        return ReadResult(None, f"{name} cannot be shown: {error}", time.time_ns())
    return ReadResult(StoredValue(value), None, time.time_ns())


def _missing_parameter(name: str) -> ReadResult:
    return ReadResult(None, f"the parameter {name} no longer exists", time.time_ns())
