"""What the adapters of embedded robots share: they answer at once, and tell of all goals."""

from __future__ import annotations

import asyncio

from rosld.adapters.model import Refused, TimedOut, TypeRef, Unreachable


class NoWatch:
    """A watch without effect, for changes that are announced in any case."""

    def close(self) -> None:
        """Nothing has to be given back."""


def require_reachable(is_open: bool, deadline: float, robot: str) -> None:
    """Raise Unreachable where the adapter of a robot is closed, TimedOut where the deadline (loop time) is over."""
    if not is_open:
        raise Unreachable(f"the {robot} is not there: the adapter is closed")
    if asyncio.get_running_loop().time() > deadline:
        raise TimedOut(f"the deadline had passed before the {robot} was asked")


def require_type(name: str, kind: str, ref: TypeRef, asked: TypeRef) -> None:
    """Raise Refused where a service or an action (`kind`) is asked as one of another type than its own."""
    if asked.name != ref.name or asked.hash not in (None, ref.hash):
        raise Refused(f"the {kind} {name} is a {ref.name}, not this {asked.name}")
