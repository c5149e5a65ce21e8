"""Dry runs: requests that plan and check a write, and end where it would take effect.

Every function that sends something to the robot, or stores something, calls `end_dry_run` right before. So resources
need not handle dry runs, and cannot forget them.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextvars import ContextVar
from typing import NamedTuple

MAX_STEPS = 100
"""Maximum number of steps, URLs, limits and conditions that a dry run or a receipt lists."""


class PlannedStep(NamedTuple):
    """A planned step: its description, and the URLs of the resources that it affects."""

    description: str
    touches: tuple[str, ...]


class DryRun:
    """The plan of one request: its steps, the completed checks, and the expected status of the real response.

    `limits` are the URLs of the resources and types whose limits were checked, `conditions` those of conditions.
    """

    def __init__(self) -> None:
        self.steps: list[PlannedStep] = []
        self.limits: list[str] = []
        self.conditions: list[str] = []
        self.status: int | None = None

    def add_step(self, description: str, touches: tuple[str, ...]) -> None:
        """Add a step, unless it is present already."""
        step = PlannedStep(description, touches)
        if step not in self.steps and len(self.steps) < MAX_STEPS:
            self.steps.append(step)


class DryRunEnded(Exception):
    """The request is a dry run, and would have taken effect here; everything that can be refused was checked."""


current_dry_run: ContextVar[DryRun | None] = ContextVar("dry_run", default=None)
"""Dry run of the current task, or None."""


def is_dry_run() -> bool:
    """Whether the current task answers a dry run."""
    return current_dry_run.get() is not None


def expect_status(status: int) -> None:
    """Set the expected status of the real response in a dry run."""
    dry_run = current_dry_run.get()
    if dry_run is not None:
        dry_run.status = status


def end_dry_run(status: int | None = None) -> None:
    """Raise DryRunEnded in a dry run; `status` as in `expect_status`."""
    if current_dry_run.get() is not None:
        if status is not None:
            expect_status(status)
        raise DryRunEnded


def note_limits(url: str) -> None:
    """Record in a dry run that the limits on a resource or a type were checked."""
    dry_run = current_dry_run.get()
    if dry_run is not None:
        _add(dry_run.limits, url)


def note_conditions(iris: Iterable[str]) -> None:
    """Record in a dry run that conditions were checked."""
    dry_run = current_dry_run.get()
    if dry_run is not None:
        for iri in iris:
            _add(dry_run.conditions, iri)


def _add(found: list[str], url: str) -> None:
    if url not in found and len(found) < MAX_STEPS:
        found.append(url)
