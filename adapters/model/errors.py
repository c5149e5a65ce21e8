"""Errors between rosld and a robot, in ROS's own terms.

    RosError
    ├── NotFound       no such node, topic, service, parameter or message
    ├── Refused        the robot said no (or the operation does not exist on it)
    ├── Unreachable    the master or the node does not answer
    ├── TimedOut       it was asked and did not answer before the deadline
    └── UnknownType    nobody could tell the definition of a type

None of them knows HTTP: `server/rest/ros_problems.py` holds the one table that gives each its status.
"""

from __future__ import annotations

from enum import Enum


class Sent(Enum):
    """Whether the robot may have received the request. Only `NO` may be retried or reported as "nothing happened"."""

    NO = "no"
    MAYBE = "maybe"
    YES = "yes"


class RosError(Exception):
    """Base of all errors of adapters: a sentence that names the value, and apart from it the robot's words.

    The sentence never has the robot's words in it: clients trust it as the server's. `about` are what the sentence
    speaks of, as URLs that the server gives it: a client that may not read them is not told the sentence.
    """

    def __init__(self, sentence: str, *, words: str | None = None, sent: Sent = Sent.NO) -> None:
        super().__init__(f"{sentence}: {words}" if words else sentence)
        self.sentence = sentence
        self.words = words
        self.sent = sent
        self.about: tuple[str, ...] = ()


class NotFound(RosError):
    """There is nothing of that name."""


class Refused(RosError):
    """The robot (or the rules of this kind of system) said no; `words` are the robot's."""


class Unreachable(RosError):
    """The master or the node cannot be reached."""


class TimedOut(RosError):
    """No response before the deadline; `sent` is whether the robot may still act on the request."""


class UnknownType(RosError):
    """The definition of a type is not known; the sentence says where it was looked for and what to do."""
