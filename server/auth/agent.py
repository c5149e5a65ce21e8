"""The agent that a request comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Agent:
    """An agent. `name` is what pages and receipts call them; `webid` is their URL where they have one."""

    name: str
    webid: str | None = None


ANONYMOUS = Agent("anybody")
"""Who asks without saying who they are."""
