"""Schemas of messages, services and actions, self-contained and immutable, and samples of messages.

Names are those of rosbags (`geometry_msgs/msg/Twist`, `std_srvs/srv/Trigger`) for both ROS 1 and ROS 2. The two
messages of a service are named `std_srvs/srv/Trigger_Request` and `std_srvs/srv/Trigger_Response`; the three of an
action are named similarly (`ActionSchema`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol, TypeAlias


class Encoding(Enum):
    """Encoding of messages."""

    ROS1 = "ros1"
    CDR = "cdr"


_TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
_MAX_TRANSFORMS = 32
"""Number of a publisher's transform messages that are stored: the newest alone may lack frames."""


def latched_depth(type_name: str) -> int:
    """Return how many latched messages to store per publisher: several for transforms, which add up."""
    return _MAX_TRANSFORMS if type_name in _TRANSFORMS else 1


class Sample(NamedTuple):
    """One message as received: owned bytes, never a view of a receive buffer.

    (publisher, epoch, sequence) identifies a sample of a topic. `sequence` counts this publisher's messages on this
    topic from 1, as received; `epoch` increases when the count restarts (a loop of a recording, a restarted node);
    `received_ns` is wall-clock time in nanoseconds (in a recording: the recorded time).
    """

    data: bytes
    encoding: Encoding
    schema: TypeRef
    publisher: str
    received_ns: int
    sequence: int
    epoch: int = 0
    latched: bool = False


@dataclass(frozen=True, slots=True)
class TypeRef:
    """A type by name and hash (ROS 1: MD5 in hex; ROS 2: `RIHS01_...`); without a hash, any known variant."""

    name: str
    hash: str | None = None


PRIMITIVES: Mapping[str, int] = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
"""Primitives, with their numbers in type_description_interfaces/msg/FieldType."""
BOUNDED_STRINGS: Mapping[str, int] = {"string": 21, "wstring": 22}
"""Numbers of strings with a bound."""
DUMMY = "structure_needs_at_least_one_member"
"""Field of types without fields."""


STRINGS = frozenset({"string", "wstring"})
OCTETS = frozenset({"uint8", "byte", "char"})
"""Primitives whose arrays are octets."""


@dataclass(frozen=True, slots=True)
class Primitive:
    """A primitive: bool, byte, char, int8 ... uint64, float32, float64, string, wstring; `bound` limits a string."""

    name: str
    bound: int | None = None


@dataclass(frozen=True, slots=True)
class Nested:
    """A field that is itself a message; its `MessageType` is in the schema's `types`."""

    name: str


@dataclass(frozen=True, slots=True)
class Array:
    """An array: of exactly `length` elements, of at most `bound`, or (both None) of any number."""

    element: Primitive | Nested
    length: int | None = None
    bound: int | None = None

    @property
    def most(self) -> int | None:
        """Maximum number of elements, or None."""
        return self.bound if self.length is None else self.length


FieldType: TypeAlias = Primitive | Nested | Array


Scalar: TypeAlias = "bool | int | float | str"
Default: TypeAlias = "Scalar | tuple[Scalar, ...]"


@dataclass(frozen=True, slots=True)
class Field:
    """A field: its ROS name, its type, and its attribute of a decoded message.

    `default` is the default value in its definition; None is zero or empty.
    """

    name: str
    type: FieldType
    attribute: str
    default: Default | None = None

    @property
    def nested(self) -> str | None:
        """The type of the message, or of the messages of the array, if it holds messages."""
        element = self.type.element if isinstance(self.type, Array) else self.type
        return element.name if isinstance(element, Nested) else None


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of a message definition."""

    name: str
    type: str
    value: bool | int | float | str


@dataclass(frozen=True, slots=True)
class MessageType:
    """Layout of a message type. Types without fields have none here, despite their dummy member in CDR."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()


class Message(Protocol):
    """A decoded message: an object whose attributes are its fields.

    Numbers are Python's; a string is `str` (bytes that are not UTF-8 are surrogate escapes); a nested message is a
    message; an array of numbers or bools is a read-only numpy array, any other array a list.
    """

    __msgtype__: str


class Codec(Protocol):
    """Converts between bytes and messages for all types of a schema."""

    def decode(self, data: bytes, encoding: Encoding) -> Message:
        """Return the message in `data`. Raises ValueError if it is not a message of this type."""

    def encode(self, message: Message, encoding: Encoding) -> bytes:
        """Return the bytes of `message`. Raises ValueError with the name of a field that does not fit."""

    def build(self, type_name: str, values: Mapping[str, object]) -> Message:
        """Return a message of a type of this schema with these attributes, which must be complete and valid."""


@dataclass(frozen=True, eq=False)
class MessageSchema:
    """A message type with everything needed to read, write and describe it.

    `types` is closed: it contains the type itself (under `ref.name`) and every type nested in it. `definition` is the
    text in ROS's format (dependencies appended after `===` lines). Two schemas of one `ref` are interchangeable, and a
    hash is always set.
    """

    ref: TypeRef
    types: Mapping[str, MessageType]
    definition: str
    codec: Codec

    @property
    def type(self) -> MessageType:
        """The message type itself."""
        return self.types[self.ref.name]


@dataclass(frozen=True, eq=False)
class ServiceSchema:
    """A service type: its two messages and the text of its definition."""

    ref: TypeRef
    request: MessageSchema
    response: MessageSchema
    definition: str


@dataclass(frozen=True, eq=False)
class ActionSchema:
    """An action type: the messages of its goal, its result and its feedback, and the text of its definition.

    They are named `control_msgs/action/PointHead_Goal`, `..._Result` and `..._Feedback`, in ROS 1 too.
    """

    ref: TypeRef
    goal: MessageSchema
    result: MessageSchema
    feedback: MessageSchema
    definition: str


Schema: TypeAlias = MessageSchema | ServiceSchema | ActionSchema


def halves_of(schema: Schema) -> tuple[MessageSchema, ...]:
    """Return the messages of a type: itself, the two of a service, or goal, result and feedback of an action."""
    if isinstance(schema, ServiceSchema):
        return schema.request, schema.response
    if isinstance(schema, ActionSchema):
        return schema.goal, schema.result, schema.feedback
    return (schema,)
