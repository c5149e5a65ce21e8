"""Access rules: agents, modes, and paths. Pure.

Nothing is allowed that no rule allows, and what one rule denies no other allows. A rule is about paths (`globs.py`)
and, where it says so, about message types: of topics, services and actions, and of the resources made of them.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TypeAlias

from rosld.server.auth.agent import ANONYMOUS, Agent
from rosld.server.auth.globs import Glob, Path, type_matches

AUTHENTICATED = "authenticated"
"""Whom rules call so: everybody who has said who they are."""
_SECRET = secrets.token_bytes(32)
_MAX_DECISIONS = 16384
"""Judgements that are remembered."""
Types: TypeAlias = frozenset[str]
"""The names of the types that a resource is of, as ROS has them; none for what is of no type."""
UNTYPED: Types = frozenset()


class Mode(Enum):
    """Access modes: read, write documents, command the robot, change access rules."""

    READ = "read"
    WRITE = "write"
    CONTROL = "control"
    ADMINISTER = "administer"


_CONTROLLED = frozenset(
    {"topics", "services", "calls", "actions", "goals", "resources", "nodes", "holds", "stop", "activity"}
)
"""The routes in which a write commands the robot."""
ACL = "acl"
"""The route that says who may do what."""
_READS = frozenset({"GET", "HEAD", "OPTIONS"})
_ASKED = frozenset({"sparql", "channels"})
"""The routes in which a POST reads: queries, and subscriptions. What an update changes is judged graph by graph."""


def mode_of(method: str, path: Path) -> Mode:
    """Return the access mode of a request with this method at this path."""
    route = path[0] if path else ""
    if route == ACL:
        return Mode.ADMINISTER
    if method in _READS or route in _ASKED:
        return Mode.READ
    if route == "stop" and method == "DELETE":
        return Mode.ADMINISTER
    return Mode.CONTROL if route in _CONTROLLED else Mode.WRITE


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule that agents may, or (`deny`) may not, use modes at paths.

    `types` are globs, and where there are any the rule is about resources of such types alone. `agents` are names or
    WebIDs, `anybody` or `authenticated`.
    """

    agents: frozenset[str]
    modes: frozenset[Mode]
    globs: tuple[Glob, ...]
    types: tuple[str, ...] = ()
    deny: bool = False

    def applies_to(self, agent: Agent) -> bool:
        """Whether it is about this agent."""
        called = {ANONYMOUS.name} | (
            {AUTHENTICATED, agent.name, agent.webid or agent.name} if agent != ANONYMOUS else set()
        )
        return not called.isdisjoint(self.agents)

    def _is_typed(self, types: Types) -> bool:
        if not self.types:
            return True
        fitting = (any(type_matches(glob, name) for glob in self.types) for name in types)
        return any(fitting) if self.deny else bool(types) and all(fitting)

    def covers(self, mode: Mode, path: Path, types: Types | None) -> bool:
        """Whether it says something of this; types that are not known yet (None) fit an allowance, and no denial."""
        return (
            mode in self.modes
            and ((not self.deny or not self.types) if types is None else self._is_typed(types))
            and any(glob.matches(path) for glob in self.globs)
        )

    def may_cover(self, mode: Mode, path: Path) -> bool:
        """Whether the rule can apply to this path, for some type."""
        return mode in self.modes and any(glob.matches(path) for glob in self.globs)

    def covers_subtree(self, mode: Mode, path: Path) -> bool:
        """Whether the rule applies to this path and everything below, for all types."""
        return mode in self.modes and not self.types and any(glob.covers_subtree(path) for glob in self.globs)

    def overlaps_subtree(self, mode: Mode, path: Path) -> bool:
        """Whether it may be about this path, or about something below."""
        return mode in self.modes and any(glob.overlaps_subtree(path) for glob in self.globs)


@dataclass(frozen=True)
class Policy:
    """All rules of a server; `agents` are those it knows, by name."""

    rules: tuple[Rule, ...] = ()
    agents: Mapping[str, Agent] = field(default_factory=dict)

    def rights_of(self, agent: Agent) -> Rights:
        """Return the rights of an agent."""
        return Rights(tuple(rule for rule in self.rules if rule.applies_to(agent)))


@dataclass(frozen=True)
class Rights:
    """The rights of one agent, by its rules."""

    rules: tuple[Rule, ...]
    _known: dict[tuple[Mode, Path, Types | None], bool] = field(default_factory=dict, repr=False, compare=False)

    def may(self, mode: Mode, path: Path, types: Types | None = UNTYPED) -> bool:
        """Whether access is permitted at a path of these types; None: for some types."""
        key = (mode, path, types)
        found = self._known.get(key)
        if found is None:
            if len(self._known) >= _MAX_DECISIONS:
                self._known.clear()
            found = self._known[key] = self._evaluate(mode, path, types)
        return found

    def may_subtree(self, mode: Mode, path: Path) -> bool:
        """Whether access is permitted at a path and everywhere below, for all types."""
        allowed = any(rule.covers_subtree(mode, path) for rule in self.rules if not rule.deny)
        return allowed and not any(rule.overlaps_subtree(mode, path) for rule in self.rules if rule.deny)

    def may_in_subtree(self, mode: Mode, path: Path) -> bool:
        """Whether this may be done at something that may lie below a path, and not everything there is denied."""
        allowed = any(rule.overlaps_subtree(mode, path) for rule in self.rules if not rule.deny)
        return allowed and not any(rule.covers_subtree(mode, path) for rule in self.rules if rule.deny)

    def may_know_any_type(self, path: Path) -> bool:
        """Whether access is permitted for all types, so that types hide nothing."""
        return any(self._may_any(mode, path) for mode in Mode)

    def _may_any(self, mode: Mode, path: Path) -> bool:
        if not any(rule.covers(mode, path, UNTYPED) for rule in self.rules if not rule.deny and not rule.types):
            return False
        return not any(rule.may_cover(mode, path) for rule in self.rules if rule.deny)

    def may_know(self, path: Path, types: Types | None = UNTYPED) -> bool:
        """Whether anything at all may be done there: only then may the agent learn whether anything is there."""
        return any(self.may(mode, path, types) for mode in Mode)

    @cached_property
    def is_unrestricted(self) -> bool:
        """Whether everything may be done everywhere."""
        return all(self.may_subtree(mode, ()) for mode in Mode)

    @cached_property
    def may_read_all(self) -> bool:
        """Whether everything may be read but the rules themselves."""
        return self.may_subtree(Mode.READ, ())

    @cached_property
    def is_typed(self) -> bool:
        """Whether any of it hangs on types."""
        return any(rule.types for rule in self.rules)

    @cached_property
    def key(self) -> str:
        """A key that agents with the same rules share, and that reveals nothing of the rules."""
        said = sorted(
            f"{sorted(mode.value for mode in rule.modes)}{[glob.text for glob in rule.globs]}{rule.types}{rule.deny}"
            for rule in self.rules
        )
        return hashlib.blake2b("\n".join(said).encode(), digest_size=6, key=_SECRET).hexdigest()

    def _evaluate(self, mode: Mode, path: Path, types: Types | None) -> bool:
        found = [rule.deny for rule in self.rules if rule.covers(mode, path, types)]
        return bool(found) and not any(found)


def allow_all_rules() -> tuple[Rule, ...]:
    """Return the rules of a server without any: everybody may do everything."""
    return (Rule(frozenset({ANONYMOUS.name}), frozenset(Mode), (Glob("/**"),)),)
