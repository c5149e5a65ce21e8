"""Messages of ROS types from plain JSON, for pages."""

from __future__ import annotations

from rosld.adapters.model import Message, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer

BASE = "http://127.0.0.1:8080/"
NOW = 1_795_225_901_123_456_789
LIBRARY = TypeLibrary(ros_version=1)


def schema(name: str) -> MessageSchema:
    """Return the schema of a message type, or of one half of a service."""
    found = LIBRARY.find(TypeRef(name))
    assert isinstance(found, MessageSchema)
    return found


def message(kind: MessageSchema, value: object) -> Message:
    """Return a message from plain JSON; missing fields have ROS's defaults."""
    return lowerer(kind).from_json(value, defaults=True)


def lifted(node: str, kind: MessageSchema, value: object, publisher: str = "nodes/aircraft") -> LiftedMessage:
    """Return a message of a document, as from a robot."""
    return LiftedMessage(node, lifter(kind), message(kind, value), Envelope(NOW, 4217, f"{BASE}{publisher}"))
