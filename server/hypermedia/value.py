"""Values: what a property is read as, and how that is written in RDF and in plain JSON. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from rosld.adapters.model import Field, Message, MessageSchema, ParameterValue


@dataclass(frozen=True, slots=True, eq=False)
class MessageValue:
    """The `fields` of a message, read from the ROS thing at the URL `origin` (where elided bytes are)."""

    schema: MessageSchema
    message: Message
    fields: tuple[Field, ...]
    origin: str


@dataclass(frozen=True, slots=True, eq=False)
class StoredValue:
    """The value of a parameter."""

    value: ParameterValue


Value: TypeAlias = MessageValue | StoredValue


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A property as it was read: its value, or why there is none.

    `failure` is a sentence (a getter that hangs, refuses or has vanished; bytes that cannot be read), None with a
    value and where there is simply none yet. `read_ns` (wall clock) is when the value was received or answered.
    `fresh_until` is the loop time until which it may be shown without asking again; None for a topic's, which is good
    until another message comes. Readings are compared by identity: the same object means that nothing changed.
    """

    name: str
    value: Value | None
    failure: str | None = None
    read_ns: int | None = None
    fresh_until: float | None = None
