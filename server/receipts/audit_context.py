"""The audit context of a request, from which its receipt is made.

All code that writes to the robot records that in `current_audit`, so that resources cannot forget what they affect or
the outcome. Resources may add more to the context of their exchange.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Sequence
from contextvars import ContextVar
from typing import NamedTuple

from rosld.server.runtime.dry_run import MAX_STEPS, current_dry_run
from rosld.server.runtime.identifiers import new_identifier


class Sender(NamedTuple):
    """Sender of a call or a goal: the agent's name and the id of the receipt."""

    agent: str
    receipt: str


class AuditContext:
    """Record of a request's effects; empty for a request that writes nothing.

    `started_ns` is the start of processing, `sent` the SHA-256 of a streamed body of `length` bytes. `leads_to_page`:
    the response redirects a browser to a page, which is to show the receipt.
    """

    __slots__ = (
        "is_write",
        "leads_to_page",
        "length",
        "matched",
        "plan",
        "receipt",
        "refusal",
        "sent",
        "started_ns",
        "touched",
    )

    sent: hashlib._Hash | None

    def __init__(self) -> None:
        self.started_ns = time.time_ns()
        self.is_write = False
        self.leads_to_page = False
        self.plan: tuple[str, ...] = ()
        self.touched: tuple[str, ...] = ()
        self.matched: int | None = None
        self.refusal: str | None = None
        self.receipt: str | None = None
        self.sent = None
        self.length = 0

    def begin(self) -> None:
        """Mark the request as a write, which leaves a receipt whatever its outcome, except in a dry run."""
        self.is_write = current_dry_run.get() is None
        current_audit.set(self)

    def receipt_id(self) -> str:
        """Return the id of the receipt that the request will leave."""
        if self.receipt is None:
            self.receipt = new_identifier()
        return self.receipt

    def mark_read_only(self) -> None:
        """Mark the request as one that changes nothing, such as a query."""
        self.is_write = False

    def add_step(self, does: str, *touches: str) -> None:
        """Add a step of the write and the URLs that it affects, unless it is present already."""
        dry_run = current_dry_run.get()
        if dry_run is not None:
            dry_run.add_step(does, touches)
        if not self.plan:
            self.plan, self.touched = (does,), touches
            return
        if does not in self.plan and len(self.plan) < MAX_STEPS:
            self.plan = (*self.plan, does)
        self._touch(touches)

    def _touch(self, urls: Iterable[str]) -> None:
        if len(self.touched) < MAX_STEPS:
            self.touched = tuple(dict.fromkeys((*self.touched, *urls)))

    def add_receivers(self, matched: int) -> None:
        """Add the number of subscribers that received a message."""
        self.matched = matched + (self.matched or 0)

    def set_refusal(self, words: str, about: Sequence[str]) -> None:
        """Record the reason of a refusal, and the URLs that it mentions."""
        self.refusal = words
        self._touch(about)

    def hash_chunk(self, chunk: bytes) -> None:
        """Add a part of a streamed body to its digest."""
        if self.sent is None:
            self.sent = hashlib.sha256()
        self.sent.update(chunk)
        self.length += len(chunk)


current_audit: ContextVar[AuditContext | None] = ContextVar("under_way", default=None)
"""Audit context of the current task's write, or None."""


def record_step(does: str, *touches: str) -> None:
    """Record a step of the current write, as `AuditContext.add_step` does."""
    context = current_audit.get()
    if context is not None:
        context.add_step(does, *touches)
