"""Parameter trees as ROS 1's master keeps them: pure functions of immutable trees, and the refusals of the wire.

A tree is a dict of values and trees; no function here changes the one it is given. Names are global ROS names,
whose empty segments count for nothing, as at the master.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import TypeAlias

from rosld.adapters.model import NotFound, Refused
from rosld.adapters.model.names import segments
from rosld.adapters.model.parameter import ParameterValue

Tree: TypeAlias = dict[str, ParameterValue]

_MAX_NESTED = 64
_INT32 = range(-(2**31), 2**31)


def read_name(tree: Tree, name: str) -> ParameterValue | None:
    """Return the value of a name, a dict where it is a tree; None where there is nothing."""
    value: ParameterValue = tree
    for step in _path(name):
        if not isinstance(value, dict) or step not in value:
            return None
        value = value[step]
    return value


def with_value(tree: Tree, name: str, value: ParameterValue) -> Tree:
    """Return the tree with `name` set, as the master does it: a scalar on the way becomes a namespace.

    Raises Refused for a root that is no dict.
    """
    path = _path(name)
    if not path and not isinstance(value, dict):
        raise Refused("the root of the parameter tree, '/', can only be set to a dict")
    return _with(tree, path, value)


def _with(tree: Tree, path: Sequence[str], value: ParameterValue) -> Tree:
    if not path:
        assert isinstance(value, dict)
        return dict(value)
    step, *rest = path
    if not rest:
        return {**tree, step: value}
    below = tree.get(step)
    return {**tree, step: _with(below if isinstance(below, dict) else {}, rest, value)}


def without_name(tree: Tree, name: str) -> Tree:
    """Return the tree without `name` and all below it. Raises NotFound, and Refused for the root."""
    path = _path(name)
    if not path:
        raise Refused("the root of the parameter tree, '/', cannot be deleted")
    if read_name(tree, name) is None:
        raise NotFound(f"there is no parameter {name!r}")
    return _without(tree, path)


def _without(tree: Tree, path: Sequence[str]) -> Tree:
    step, *rest = path
    if not rest:
        return {key: value for key, value in tree.items() if key != step}
    below = tree[step]
    assert isinstance(below, dict)
    return {**tree, step: _without(below, rest)}


def leaves(tree: Mapping[str, ParameterValue], prefix: str = "") -> Iterator[str]:
    """The names of all values that are no trees, as `getParamNames` lists them (an empty tree is not listed)."""
    for key, value in tree.items():
        name = f"{prefix}/{key}"
        if isinstance(value, dict):
            yield from leaves(value, name)
        else:
            yield name


def check(name: str, value: object, depth: int = 0) -> None:
    """Raise Refused, naming the parameter, for a value that ROS 1's parameter server could not hold."""
    if depth > _MAX_NESTED:
        raise Refused(f"the parameter {name} is nested more than {_MAX_NESTED} deep")
    if isinstance(value, int) and not isinstance(value, bool) and value not in _INT32:
        raise Refused(f"the parameter {name} cannot be {value}: ROS 1 parameters hold integers of 32 bits")
    if isinstance(value, dict):
        for key, below in value.items():
            _check_key(name, key)
            check(f"{name}/{key}", below, depth + 1)
    elif isinstance(value, list):
        for item in value:
            check(name, item, depth + 1)
    elif not isinstance(value, (bool, int, float, str, bytes, datetime)):
        raise Refused(f"the parameter {name} cannot be {value!r}: ROS 1 parameters cannot have such a value")


def deep_copy(value: ParameterValue) -> ParameterValue:
    """Return a value that shares no list and no dict with `value`."""
    if isinstance(value, dict):
        return {key: deep_copy(below) for key, below in value.items()}
    if isinstance(value, list):
        return [deep_copy(item) for item in value]
    return value


def _check_key(name: str, key: object) -> None:
    if not isinstance(key, str) or not key or "/" in key:
        raise Refused(f"the parameter {name} cannot hold the key {key!r}: a key is a non-empty name without slashes")


def _path(name: str) -> tuple[str, ...]:
    return tuple(step for step in segments(name) if step)
