"""Parameter trees as ROS 1's master keeps them: pure functions of immutable trees, and the refusals of the wire.

A tree is a dict of values and trees; no function here changes the one it is given. Names are global ROS names,
whose empty segments count for nothing, as at the master.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
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
    if not path:
        if not isinstance(value, dict):
            raise Refused("the root of the parameter tree, '/', can only be set to a dict")
        return dict(value)
    *above, last = path
    place = changed = copy.deepcopy(tree)
    for step in above:
        below = place.get(step)
        if not isinstance(below, dict):
            below = place[step] = {}
        place = below
    place[last] = value
    return changed


def without_name(tree: Tree, name: str) -> Tree:
    """Return the tree without `name` and all below it. Raises NotFound, and Refused for the root."""
    path = _path(name)
    if not path:
        raise Refused("the root of the parameter tree, '/', cannot be deleted")
    if read_name(tree, name) is None:
        raise NotFound(f"there is no parameter {name!r}")
    changed = copy.deepcopy(tree)
    parent = read_name(changed, "/" + "/".join(path[:-1]))
    assert isinstance(parent, dict)
    del parent[path[-1]]
    return changed


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


def _check_key(name: str, key: object) -> None:
    if not isinstance(key, str) or not key or "/" in key:
        raise Refused(f"the parameter {name} cannot hold the key {key!r}: a key is a non-empty name without slashes")


def _path(name: str) -> tuple[str, ...]:
    return tuple(step for step in segments(name) if step)
