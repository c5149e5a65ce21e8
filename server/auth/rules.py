"""Access rules: agents, modes, and globs over the paths of one server. Pure.

Everything is forbidden unless a rule allows it, and a denial overrides all allowances. A rule applies to paths and, if
specified, to message types: of topics, services and actions, and of the resources composed of them.

In a glob, `*` matches any characters of one segment, `**` any number of whole segments, including none. Paths are
compared decoded: percent-encoding is removed once from each segment, so that no spelling of a name escapes its rule,
and an encoded slash (`%2F`) is part of its segment. A final slash makes no difference.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property, lru_cache
from typing import TypeAlias
from urllib.parse import unquote

from msgspec import Struct
from msgspec.structs import replace

from rosld.ontology.urls import Location, decode_segment


class Agent(Struct, frozen=True):
    """An agent. `name` is used on pages and receipts; `webid` is the agent's URL, if any."""

    name: str
    webid: str | None = None


ANONYMOUS = Agent("anybody")
"""Agent of unauthenticated requests."""


Path: TypeAlias = tuple[str, ...]
"""Decoded segments of a path below the base; the entry point has none."""
_ANY = "**"
_NOT_IN_PATHS = re.compile(r"[?#\[\]\x00-\x20\x7f]")


def path_at(location: Location) -> Path:
    """Return the path to which rules apply; a container has the path of its name."""
    return (location.kind, *location.segments) if location.kind else location.segments


class Glob(Struct, frozen=True, dict=True):
    """A glob such as `/topics/camera/**`. Raises ValueError with a sentence if it is invalid."""

    text: str

    def __post_init__(self) -> None:
        if not self.text.startswith("/"):
            raise ValueError(
                f"{self.text!r} must begin with a slash: globs are paths below the base, such as /topics/**"
            )
        if found := _NOT_IN_PATHS.search(self.text):
            raise ValueError(f"{self.text!r} contains {found[0]!r}: the only wildcards are * and **")
        assert self._parts is not None

    @cached_property
    def _parts(self) -> tuple[re.Pattern[str] | None, ...]:
        """A pattern for each segment, None for `**`."""
        segments = self.text.strip("/").split("/") if self.text.strip("/") else []
        if segments == ["ontology"]:
            segments.append(_ANY)  # its modules are parts of it
        return tuple(None if each == _ANY else self._part(each) for each in segments)

    def _part(self, segment: str) -> re.Pattern[str]:
        if _ANY in segment:
            raise ValueError(f"{self.text!r}: ** matches whole segments and must stand alone between slashes")
        if not segment:
            raise ValueError(f"{self.text!r} has an empty segment: write an empty part of a name as ~")
        if "*" not in segment:
            try:
                return re.compile(re.escape(decode_segment(segment)))
            except ValueError as error:
                raise ValueError(f"{self.text!r}: {error}") from error
        literal = (re.escape(unquote(each, errors="strict")) for each in segment.split("*"))
        return re.compile(".*".join(literal), re.DOTALL)

    def below(self, path: Path) -> Iterator[Glob]:
        """Yield the globs that match, relative to a path, what this one matches below it."""
        segments = self.text.strip("/").split("/")
        for state in self._states_after(path):
            yield Glob("/" + "/".join(segments[state:]))

    def matches(self, path: Path) -> bool:
        """Whether the glob matches this path."""
        return len(self._parts) in self._states_after(path)

    def overlaps_subtree(self, path: Path) -> bool:
        """Whether the glob matches this path or may match one below."""
        return bool(self._states_after(path))

    def covers_subtree(self, path: Path) -> bool:
        """Whether the glob matches this path and everything below."""
        last = len(self._parts) - 1
        return last >= 0 and self._parts[last] is None and last in self._states_after(path)

    def _states_after(self, path: Path) -> frozenset[int]:
        """Return the possible positions in the glob after the path."""
        states = self._skip_any({0})
        for segment in path:
            after = set()
            for state in states:
                if state == len(self._parts):
                    continue
                part = self._parts[state]
                if part is None:
                    after.add(state)
                elif part.fullmatch(segment):
                    after.add(state + 1)
            states = self._skip_any(after)
            if not states:
                break
        return frozenset(states)

    def _skip_any(self, states: set[int]) -> set[int]:
        """Return these positions, and those after each `**`, which may match nothing."""
        found = set(states)
        for state in sorted(states):
            while state < len(self._parts) and self._parts[state] is None:
                state += 1
                found.add(state)
        return found


@lru_cache(maxsize=1024)
def _type_pattern(glob: str) -> re.Pattern[str]:
    return re.compile(".*".join(map(re.escape, glob.split("*"))), re.DOTALL)


def type_matches(glob: str, name: str) -> bool:
    """Whether a glob over message types (`sensor_msgs/msg/*`) matches a type; `*` matches any characters."""
    return _type_pattern(glob).fullmatch(name) is not None


AUTHENTICATED = "authenticated"
"""Name in rules for all authenticated agents."""
_SECRET = secrets.token_bytes(32)
_MAX_DECISIONS = 16384
"""Maximum number of cached decisions."""
Types: TypeAlias = frozenset[str]
"""ROS names of a resource's types; empty if it has none."""
UNTYPED: Types = frozenset()


class Mode(Enum):
    """Access modes: read, write documents, command the robot, change access rules."""

    READ = "read"
    WRITE = "write"
    CONTROL = "control"
    ADMINISTER = "administer"


_CONTROLLED = frozenset(
    {"topics", "services", "calls", "actions", "goals", "resources", "nodes", "holds", "faults", "stop", "activity"}
)
"""Routes in which a write commands the robot."""
ACL = "acl"
"""Route of the access rules."""
ROBOTS = "robots"
"""Route of the robots of a server with several. Those who add and remove them administer it."""
_READS = frozenset({"GET", "HEAD", "OPTIONS"})
_READ_BY_POST = frozenset({"sparql", "channels"})
"""Routes in which a POST reads: queries and subscriptions. Updates are judged for each graph they change."""


def mode_of(method: str, path: Path) -> Mode:
    """Return the access mode of a request with this method at this path."""
    route = path[0] if path else ""
    if route == ACL:
        return Mode.ADMINISTER
    if method in _READS or route in _READ_BY_POST:
        return Mode.READ
    if route == ROBOTS or (route == "stop" and method == "DELETE"):
        return Mode.ADMINISTER
    return Mode.CONTROL if route in _CONTROLLED else Mode.WRITE


class Rule(Struct, frozen=True):
    """A rule that permits (or, with `deny`, forbids) agents to use modes at paths.

    `types` are globs that limit the rule to resources of such types. `agents` are names or WebIDs, `anybody` or
    `authenticated`.
    """

    agents: frozenset[str]
    modes: frozenset[Mode]
    globs: tuple[Glob, ...]
    types: tuple[str, ...] = ()
    deny: bool = False

    def applies_to(self, agent: Agent) -> bool:
        """Whether the rule applies to this agent."""
        called = {ANONYMOUS.name} | (
            {AUTHENTICATED, agent.name, agent.webid or agent.name} if agent != ANONYMOUS else set()
        )
        return not called.isdisjoint(self.agents)

    def _is_typed(self, types: Types) -> bool:
        if not self.types:
            return True
        fitting = (any(type_matches(glob, name) for glob in self.types) for name in types)
        return any(fitting) if self.deny else bool(types) and all(fitting)

    def below(self, path: Path) -> Iterator[Rule]:
        """Yield the rule for what is below a path, with globs relative to it, if it applies to anything there."""
        if globs := tuple(each for glob in self.globs for each in glob.below(path)):
            yield replace(self, globs=globs)

    def covers(self, mode: Mode, path: Path, types: Types | None) -> bool:
        """Whether the rule covers a request; unknown types (None) fit an allowance, but not a denial."""
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
        """Whether the rule may apply to this path or to something below."""
        return mode in self.modes and any(glob.overlaps_subtree(path) for glob in self.globs)


class Policy(Struct, frozen=True):
    """All rules of a server; `agents` are the declared ones, by name."""

    rules: tuple[Rule, ...] = ()
    agents: Mapping[str, Agent] = field(default_factory=dict)

    def below(self, path: Path) -> Policy:
        """Return the policy of a server whose base is at this path."""
        return replace(self, rules=tuple(each for rule in self.rules for each in rule.below(path)))

    def rights_of(self, agent: Agent) -> Rights:
        """Return the rights of an agent."""
        return Rights(tuple(rule for rule in self.rules if rule.applies_to(agent)))


@dataclass(frozen=True)
class Rights:
    """The rights of one agent, by its rules."""

    rules: tuple[Rule, ...]
    _known: dict[tuple[Mode, Path, Types | None], bool] = field(default_factory=dict, repr=False, compare=False)
    _subtrees: dict[Path, bool] = field(default_factory=dict, repr=False, compare=False)
    """Decisions on whole robots, for which each request would need 20 to 80 us with nine rules."""

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
        """Whether access is permitted somewhere at or below a path, and not all of it is denied."""
        allowed = any(rule.overlaps_subtree(mode, path) for rule in self.rules if not rule.deny)
        return allowed and not any(rule.covers_subtree(mode, path) for rule in self.rules if rule.deny)

    def may_know_in_subtree(self, path: Path) -> bool:
        """Whether any access is permitted somewhere at or below a path."""
        if path not in self._subtrees:
            self._subtrees[path] = any(self.may_in_subtree(mode, path) for mode in Mode)
        return self._subtrees[path]

    def may_know_any_type(self, path: Path) -> bool:
        """Whether access is permitted for all types, so that types hide nothing."""
        return any(self._may_any(mode, path) for mode in Mode)

    def _may_any(self, mode: Mode, path: Path) -> bool:
        if not any(rule.covers(mode, path, UNTYPED) for rule in self.rules if not rule.deny and not rule.types):
            return False
        return not any(rule.may_cover(mode, path) for rule in self.rules if rule.deny)

    def may_know(self, path: Path, types: Types | None = UNTYPED) -> bool:
        """Whether any access is permitted: only then may the agent learn whether the resource exists."""
        return any(self.may(mode, path, types) for mode in Mode)

    @cached_property
    def is_unrestricted(self) -> bool:
        """Whether all access is permitted everywhere."""
        return all(self.may_subtree(mode, ()) for mode in Mode)

    @cached_property
    def may_read_all(self) -> bool:
        """Whether everything but the rules may be read."""
        return self.may_subtree(Mode.READ, ())

    @cached_property
    def is_typed(self) -> bool:
        """Whether the rights depend on types."""
        return any(rule.types for rule in self.rules)

    @cached_property
    def key(self) -> str:
        """Key shared by agents with equal rules, which reveals nothing about the rules."""
        texts = sorted(
            f"{sorted(mode.value for mode in rule.modes)}{[glob.text for glob in rule.globs]}{rule.types}{rule.deny}"
            for rule in self.rules
        )
        return hashlib.blake2b("\n".join(texts).encode(), digest_size=6, key=_SECRET).hexdigest()

    def _evaluate(self, mode: Mode, path: Path, types: Types | None) -> bool:
        found = [rule.deny for rule in self.rules if rule.covers(mode, path, types)]
        return bool(found) and not any(found)


def allow_all_rules() -> tuple[Rule, ...]:
    """Return the rules of a server without a configuration: all access is permitted."""
    return (Rule(frozenset({ANONYMOUS.name}), frozenset(Mode), (Glob("/**"),)),)
