"""Storage of calls, goals and faults by id, limited in number and age."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, Generic, Protocol, TypeVar

from rosld.server.http.problem import Problem
from rosld.server.receipts.audit import record_step
from rosld.server.runtime.dry_run import end_dry_run, is_dry_run
from rosld.server.runtime.tasks import Signal

MAX_REMEMBERED = 10_000
"""Maximum number of removed ids that are remembered as such."""


class Gone(LookupError):
    """It existed but is no longer stored."""


class Identified(Protocol):
    """Something with an id."""

    @property
    def id(self) -> str: ...


T = TypeVar("T", bound=Identified)
Outcome = TypeVar("Outcome")


class LimitedStore(Generic[T]):
    """Store of immutable versions; above the limit, what `may_go` is removed first.

    `changes` is emitted with the `subjects` of each change, `revision` counts the changes.
    """

    word = ""
    """Name of a stored thing."""

    def __init__(self, limit: int, age: float | None = None) -> None:
        """Initialize; `age` in seconds (None: any)."""
        self._limit = limit
        self._age_ns = None if age is None else int(age * 1e9)
        self._stored: OrderedDict[str, T] = OrderedDict()
        self._removed: OrderedDict[str, None] = OrderedDict()
        self._keyed: OrderedDict[tuple[str, str], tuple[bytes, asyncio.Task[Any]]] = OrderedDict()
        self.revision = 0
        self.changes = Signal()

    def subjects(self, one: T) -> Sequence[str]:
        """Return what `changes` is emitted with: the id, and the name of what it is of, if any."""
        return (one.id,)

    def may_go(self, one: T) -> bool:
        """Whether it may be removed before others."""
        return True

    def changed_ns(self, one: T) -> int:
        """Return the time from which the age counts."""
        raise NotImplementedError

    def all(self) -> Sequence[T]:
        """Return all, oldest first."""
        self._forget_old()
        return list(self._stored.values())

    def find(self, id: str) -> T:
        """Return one by its id. Raises Gone for a deleted or expired one, KeyError for an unknown one."""
        self._forget_old()
        if id in self._removed:
            raise Gone(id)
        return self._stored[id]

    def get(self, id: str) -> T | None:
        """Return a stored one, whatever its age."""
        return self._stored.get(id)

    def subject_of(self, id: str) -> str | None:
        """Return the name of what it is of, "" for a removed one, None for an unknown one (thread-safe)."""
        one = self._stored.get(id)
        return self.subjects(one)[-1] if one is not None else "" if id in self._removed else None

    def delete(self, id: str) -> None:
        """Remove one; raises as `find`."""
        record_step(f"forget the {self.word} {self.find(id).id}")
        end_dry_run(204)
        self._drop(id)

    def keep(self, one: T) -> None:
        """Store one, or its next version."""
        self._stored[one.id] = one
        self._revise(one)
        while len(self._stored) > self._limit:
            others = (each.id for each in self._stored.values() if self.may_go(each) and each.id != one.id)
            self._drop(next(others, None) or next(iter(self._stored)))

    async def send_once(
        self, subject: str, once: tuple[str, bytes] | None, send: Callable[[], Coroutine[Any, Any, Outcome]]
    ) -> Outcome:
        """Send, unless a request with the same key and body (`once`) was sent before: return the outcome of that.

        Raises a 422 Problem for a key that was used with another body.
        """
        if once is None:
            return await send()
        key, digest = once[0], hashlib.blake2b(once[1]).digest()
        known = self._keyed.get((subject, key))
        if known is not None and known[0] != digest:
            raise Problem(422, f"The Idempotency-Key {key!r} was already used with another {self.word}.")
        if known is None and is_dry_run():
            return await send()
        if known is None:
            known = self._keyed[subject, key] = (digest, asyncio.get_running_loop().create_task(send()))
            while len(self._keyed) > self._limit:
                self._keyed.popitem(last=False)
        outcome: Outcome = await asyncio.shield(known[1])
        return outcome

    def _drop(self, id: str) -> None:
        one = self._stored.pop(id)
        self._removed[id] = None
        while len(self._removed) > MAX_REMEMBERED:
            self._removed.popitem(last=False)
        self._revise(one)

    def _forget_old(self) -> None:
        if self._age_ns is not None:
            horizon = time.time_ns() - self._age_ns
            for one in [each for each in self._stored.values() if self.changed_ns(each) < horizon]:
                self._drop(one.id)

    def _revise(self, one: T) -> None:
        self.revision += 1
        for each in self.subjects(one):
            self.changes.emit(each)
