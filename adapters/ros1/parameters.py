"""Parameters: one tree at the master, whose leaves have names.

A name consists of the keys joined by slashes. Keys may be empty or contain slashes (both occur); the master cannot
return such parameters by name, so they are read from the tree that contains them, and only set with the whole tree.
"""

from __future__ import annotations

import asyncio
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from typing import NamedTuple

from rosld.adapters.model import NotFound, Operation, Parameter, Refused, TimedOut
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.master import MasterApi

_NOT_XML = re.compile(r"[^\t\n\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_MAX_DEPTH = 100
_INT32 = range(-(2**31), 2**31)
_MAX_HINTS = 1000
_ROOT = frozenset({Operation.GET_PARAMETER, Operation.SET_PARAMETER})
_ALL = _ROOT | {Operation.DELETE_PARAMETER}


class Leaf(NamedTuple):
    """A leaf of the tree: its keys from the root, and its value (an empty tree is a leaf, too)."""

    path: tuple[str, ...]
    value: ParameterValue

    @property
    def odd(self) -> bool:
        """Whether the master cannot return it by name."""
        return any(not key or "/" in key for key in self.path)


def leaves(tree: Mapping[str, ParameterValue], above: tuple[str, ...] = ()) -> Iterator[Leaf]:
    """Yield the leaves of a tree under the keys `above`, in the tree's order."""
    stack: list[tuple[tuple[str, ...], ParameterValue]] = [((*above, key), value) for key, value in tree.items()]
    stack.reverse()
    while stack:
        path, value = stack.pop()
        if isinstance(value, dict) and value:
            stack.extend(((*path, key), each) for key, each in reversed(value.items()))
        else:
            yield Leaf(path, value)


def by_name(entries: Iterator[Leaf]) -> dict[str, Leaf]:
    """Return leaves by name; the first one for duplicate names."""
    named: dict[str, Leaf] = {}
    for leaf in entries:
        named.setdefault("/" + "/".join(leaf.path), leaf)
    return named


def find(tree: ParameterValue, rest: str) -> ParameterValue | None:
    """Return the value at `rest` (a name without its leading slash) in a tree with any keys, or None."""
    if not isinstance(tree, dict):
        return None
    if rest in tree:
        return tree[rest]
    for key, value in tree.items():
        if rest.startswith(key + "/") and (found := find(value, rest[len(key) + 1 :])) is not None:
            return found
    return None


def differences(old: Mapping[str, Leaf], new: Mapping[str, Leaf]) -> list[str]:
    """Return the names of the leaves that were added, removed or changed."""
    changed = [name for name, leaf in new.items() if name not in old or not _equal(old[name].value, leaf.value)]
    return [*changed, *(old.keys() - new.keys())]


def _equal(one: ParameterValue, other: ParameterValue) -> bool:
    return one is other or (type(one) is type(other) and repr(one) == repr(other))  # unlike ==, for NaN and 1.0


def assign(named: Mapping[str, Leaf], name: str, value: ParameterValue) -> dict[str, Leaf]:
    """Return the leaves after the master sets `name`, which replaces everything at or below it, and a leaf above it."""
    path = tuple(name[1:].split("/")) if name != "/" else ()
    above = {"/" + "/".join(path[:length]) for length in range(1, len(path))}
    remaining = {each: leaf for each, leaf in without(named, name).items() if each not in above}
    new = leaves(value, path) if isinstance(value, dict) and value else iter([Leaf(path, value)])
    return {**remaining, **(by_name(new) if path or value else {})}


def without(named: Mapping[str, Leaf], name: str) -> dict[str, Leaf]:
    """Return the leaves without `name` and everything below it."""
    below = name.rstrip("/") + "/"
    return {each: leaf for each, leaf in named.items() if each != name and not each.startswith(below)}


def parts_of(values: Mapping[str, ParameterValue]) -> dict[str, ParameterValue]:
    """Return the values to set and all values in their trees, by name."""
    parts: dict[str, ParameterValue] = {}
    for name, value in values.items():
        parts[name] = value
        if isinstance(value, dict):
            parts |= parts_of({f"{name.rstrip('/')}/{key}": each for key, each in value.items()})
    return parts


def with_parts(name: str, value: ParameterValue, parts: Mapping[str, ParameterValue]) -> ParameterValue:
    """Return the value of a name with new values for some of its parts."""
    if name in parts or not isinstance(value, dict):
        return parts.get(name, value)
    return {key: with_parts(f"{name.rstrip('/')}/{key}", each, parts) for key, each in value.items()}


def check(name: str, value: ParameterValue) -> None:
    """Raise Refused, naming the parameter, if it cannot be set to this value without loss."""
    if words := _objection(value, 0):
        raise Refused(f"the parameter {name} cannot be set: {words}")
    if name == "/" and not isinstance(value, dict):
        raise Refused("the parameter / is the root of the tree: it can only be set to a tree")


def _objection(value: object, depth: int) -> str | None:
    """Return why XML-RPC or the master would not preserve this value, or None."""
    if depth > _MAX_DEPTH:
        return f"it is nested more than {_MAX_DEPTH} deep"
    if isinstance(value, (bool, bytes)):
        return None
    if isinstance(value, int):
        return None if value in _INT32 else f"{value} does not fit the 32 bits of ROS 1 parameters"
    if isinstance(value, float):
        return None if math.isfinite(value) else f"{value} is not a number that ROS 1 parameters can hold"
    if isinstance(value, str):
        return _text_objection(value)
    if isinstance(value, datetime):
        plain = value.tzinfo is None and not value.microsecond
        return None if plain else f"{value.isoformat()} has a zone or fractions of a second, which XML-RPC cannot carry"
    if isinstance(value, (list, tuple)):
        return next((words for each in value if (words := _objection(each, depth + 1))), None)
    if isinstance(value, dict):
        return _tree_objection(value, depth)
    return f"ROS 1 has no parameters of type {type(value).__name__}"


def _text_objection(text: str) -> str | None:
    match = _NOT_XML.search(text)
    return f"XML cannot carry the character {match[0]!r} of {text[:40]!r}" if match else None


def _tree_objection(tree: Mapping[object, object], depth: int) -> str | None:
    for key, value in tree.items():
        words = _text_objection(key) if isinstance(key, str) else f"{key!r} is not a valid key"
        if words := words or _objection(value, depth + 1):
            return words
    return None


def _plain_name(name: str) -> str:
    """Return the name if the master preserves it. Raises Refused if the master would change it to another name."""
    if not name.startswith("/") or (name != "/" and "" in name[1:].split("/")):
        raise Refused(f"the parameter {name!r}: ROS 1 drops empty segments; set its whole parent tree")
    if words := _text_objection(name):
        raise Refused(f"the parameter {name!r}: {words}")
    return name


class Parameters:
    """Parameters of a master: read, written, and watched by polling the tree.

    `changed` is called with changed names; `leaves` and `trees` are those last read (an empty tree is a leaf, but not a
    parameter of the graph, as in the master's own list). All methods except `operations` run on the reading thread.
    """

    def __init__(self, master: MasterApi, changed: Callable[[Sequence[str]], None]) -> None:
        self.leaves: Mapping[str, Leaf] = {}
        self.trees: frozenset[str] = frozenset("/")
        self.graph_parameters: Mapping[str, Parameter] = {}
        self.took = 0.0
        self._master = master
        self._changed = changed
        self._document: bytes | None = None
        self._writes = 0

    def value(self, name: str) -> ParameterValue | None:
        """Return the value of a leaf as last read, or None."""
        leaf = self.leaves.get(name)
        return leaf.value if leaf else None

    def operations(self, name: str) -> frozenset[Operation]:
        """Return the operations on a parameter or a tree (thread-safe)."""
        leaf = self.leaves.get(name)
        if leaf is None and name not in self.trees:
            return frozenset({Operation.SET_PARAMETER})
        if leaf is not None and leaf.odd:
            return frozenset({Operation.GET_PARAMETER})
        return _ROOT if name == "/" else _ALL

    async def poll(self) -> None:
        """Read the tree and report changes. Raises Unreachable, TimedOut."""
        writes, started = self._writes, time.monotonic()
        document = await self._master.parameters_document()
        if writes == self._writes and document != self._document:  # otherwise the tree may be older than our own write
            self._update(by_name(leaves(self._master.parameter_tree(document))))
            self._document = document
        self.took = time.monotonic() - started

    async def get(self, names: Sequence[str], until: float) -> dict[str, ParameterValue]:
        """Return the values of the names that exist."""
        values: dict[str, ParameterValue] = {}
        for name in names:
            value = await self._get(name, until)
            if value is not None:
                values[name] = value
        return values

    async def set(self, values: Mapping[str, ParameterValue], until: float) -> None:
        """Set parameters one by one, after checking all of them. Raises Refused naming the parameter."""
        self.check(values)
        for name, value in values.items():
            with self._writing():
                await self._master.call("setParam", name, value, timeout=_seconds_left(until))
                self._update(assign(self.leaves, name, value))

    def check(self, values: Mapping[str, ParameterValue]) -> None:
        """Raise Refused, naming the parameter, if one cannot be set to its value."""
        for name, value in values.items():
            self._check_settable(name)
            check(name, value)

    def note_set(self, values: Mapping[str, ParameterValue]) -> None:
        """Record values that nodes have set at the master."""
        for name, value in values.items():
            with self._writing():
                self._update(assign(self.leaves, name, value))

    async def delete(self, names: Sequence[str], until: float) -> None:
        """Delete parameters. Raises NotFound, Refused."""
        for name in names:
            if name == "/":
                raise Refused("the root of the parameters cannot be deleted; delete its children")
            self._check_settable(name)
        for name in names:
            with self._writing():
                try:
                    await self._master.call("deleteParam", name, timeout=_seconds_left(until))
                except NotFound as error:
                    raise NotFound(f"there is no parameter {name}", words=error.words) from error
                self._update(without(self.leaves, name))

    def _check_settable(self, name: str) -> None:
        leaf = self.leaves.get(name)
        if leaf is not None and leaf.odd:
            raise Refused(f"a parent key of the parameter {name} is empty or contains a slash; set its whole tree")
        _plain_name(name)

    async def _get(self, name: str, until: float) -> ParameterValue | None:
        try:
            return await self._master.call("getParam", _plain_name(name), timeout=_seconds_left(until))
        except (NotFound, Refused):
            pass
        if not self._may_be_odd(name):
            return None
        try:
            tree = await self._master.call("getParam", "/", timeout=_seconds_left(until))
            return find(tree, name[1:])
        except NotFound:
            return None

    def _may_be_odd(self, name: str) -> bool:
        below = name + "/"
        return any(leaf.odd and (each == name or each.startswith(below)) for each, leaf in self.leaves.items())

    def _update(self, named: Mapping[str, Leaf]) -> None:
        changed = differences(self.leaves, named)
        self.leaves = named
        self.trees = frozenset(_trees(named))
        self.graph_parameters = {name: Parameter(name) for name, leaf in named.items() if leaf.value != {}}
        if changed:
            self._changed(changed[:_MAX_HINTS])

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Mark trees as outdated that were requested before the end of a write."""
        self._writes += 1
        try:
            yield
        finally:
            self._writes += 1


def _trees(named: Mapping[str, Leaf]) -> Iterator[str]:
    """Yield the names of all trees that contain these leaves, the root first."""
    yield "/"
    for name, leaf in named.items():
        if not leaf.odd:
            above = name.rpartition("/")[0]
            while above:
                yield above
                above = above.rpartition("/")[0]


def _seconds_left(until: float) -> float:
    """Return the seconds left. Raises TimedOut, with nothing sent, if there are none."""
    left = until - asyncio.get_running_loop().time()
    if left <= 0:
        raise TimedOut("the deadline passed before the request was sent to the master")
    return left
