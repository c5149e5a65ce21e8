"""Plans: writes of which all that could be refused has been looked at, and nothing has been done."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeAlias

from rosld.server.storage import Write


@dataclass(frozen=True, slots=True)
class RobotWrite:
    """The robot is to be told something: `does` says what, `carry_out` does it and tells whether it was heard.

    `carry_out` raises RosError, and Problems where the robot declines.
    """

    description: str
    carry_out: Callable[[], Awaitable[bool]]


@dataclass(frozen=True, slots=True)
class StorageWrite:
    """Something is to be kept, or to be kept no longer: these writes together do it."""

    description: str
    writes: tuple[Write, ...]


Plan: TypeAlias = "RobotWrite | StorageWrite"
