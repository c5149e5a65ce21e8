"""Agents, which make requests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Agent:
    """An agent. `name` is used on pages and receipts; `webid` is the agent's URL, if any."""

    name: str
    webid: str | None = None


ANONYMOUS = Agent("anybody")
"""Agent of unauthenticated requests."""
