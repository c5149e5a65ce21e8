"""Samples: messages as they came, each with where it came from and when."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from rosld.adapters.model.schema import TypeRef


class Encoding(Enum):
    """How the bytes of a message are laid out."""

    ROS1 = "ros1"
    CDR = "cdr"


_TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
_MAX_TRANSFORMS = 32
"""Messages with transforms of one publisher: together they hold its frames, and the newest may hold just one."""


def latched_depth(type_name: str) -> int:
    """Number of latched messages to keep per publisher; transforms add up, so more than one counts."""
    return _MAX_TRANSFORMS if type_name in _TRANSFORMS else 1


class Sample(NamedTuple):
    """One message as received: owned bytes, never a view of a receive buffer.

    Identity: (publisher, epoch, sequence) tells two samples of one topic apart.
    `sequence` counts this publisher's messages on this topic from 1 as this side saw them; `epoch` rises
    when that count begins anew (a loop of a recording, a restarted node); `received_ns` is wall-clock time
    in nanoseconds (for a recording: when it was recorded).
    """

    data: bytes
    encoding: Encoding
    schema: TypeRef
    publisher: str
    received_ns: int
    sequence: int
    epoch: int = 0
    latched: bool = False
