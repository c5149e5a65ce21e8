"""Plans: writes that are fully checked and not yet carried out."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeAlias

from rosld.server.storage.record import Write


@dataclass(frozen=True, slots=True)
class RobotWrite:
    """A write to the robot: `does` describes it, `carry_out` performs it and returns whether it was received.

    `carry_out` raises RosError, and Problems where the robot declines.
    """

    description: str
    carry_out: Callable[[], Awaitable[bool]]


@dataclass(frozen=True, slots=True)
class StorageWrite:
    """Writes to the storage, done together in one transaction."""

    description: str
    writes: tuple[Write, ...]


Plan: TypeAlias = "RobotWrite | StorageWrite"
