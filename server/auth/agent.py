"""Agents, which make requests."""

from __future__ import annotations

from msgspec import Struct


class Agent(Struct, frozen=True):
    """An agent. `name` is used on pages and receipts; `webid` is the agent's URL, if any."""

    name: str
    webid: str | None = None


ANONYMOUS = Agent("anybody")
"""Agent of unauthenticated requests."""
