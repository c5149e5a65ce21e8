"""Errors between rosld and a robot, in ROS terms.

    RosError
    ├── NotFound       no such node, topic, service, parameter or message
    ├── Refused        the robot refuses (or the operation does not exist on it)
    ├── Unreachable    the master or the node does not answer
    │   └── Unreadable a recording cannot be read
    ├── TimedOut       the request was sent and not answered before the deadline
    └── UnknownType    the definition of a type cannot be found

They are independent of HTTP: the table in `server/rest/ros_problems.py` assigns HTTP statuses.
"""

from __future__ import annotations

from enum import Enum


class Sent(Enum):
    """Whether the robot may have received the request. Only `NO` may be retried or reported as "nothing happened"."""

    NO = "no"
    MAYBE = "maybe"
    YES = "yes"


class RosError(Exception):
    """Base class of the adapters' errors: a sentence of rosld that names the value, and the robot's own `words`.

    The sentence never quotes the robot, because clients trust it. `about`, which the server sets, are URLs of what the
    sentence mentions: a client without read access to them does not get the sentence.
    """

    def __init__(self, sentence: str, *, words: str | None = None, sent: Sent = Sent.NO) -> None:
        super().__init__(f"{sentence}: {words}" if words else sentence)
        self.sentence = sentence
        self.words = words
        self.sent = sent
        self.about: tuple[str, ...] = ()


class NotFound(RosError):
    """The named thing does not exist."""


class Refused(RosError):
    """The robot (or the kind of system) refuses; `words` are the robot's."""


class Unreachable(RosError):
    """The master or the node cannot be reached."""


class Unreadable(Unreachable):
    """A recording cannot be read: it is damaged, or of an unknown format."""


class TimedOut(RosError):
    """No response before the deadline; `sent` is whether the robot may still act on the request."""


class UnknownType(RosError):
    """The definition of a type is unknown; the sentence names the places searched and what to do."""
