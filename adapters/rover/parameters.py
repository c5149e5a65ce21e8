"""The parameters of the rover's node by their global names, as ROS 2 declares them. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from rosld.adapters.model import NotFound, Operation, ParameterValue, Refused, Sent, coerce
from rosld.adapters.rover.graph import GRAPH_PARAMETERS
from rosld.adapters.rover.settings import NODE, PARAMETERS, Value, problem_of

_PREFIX = f"{NODE}/"


def operations_on(name: str) -> frozenset[Operation]:
    """What may be done with a parameter: the node keeps what it declared, and takes nothing else."""
    declared = PARAMETERS.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None
    if declared is None:
        return frozenset()
    return frozenset({Operation.GET_PARAMETER, *([] if declared.is_read_only else [Operation.SET_PARAMETER])})


def read(values: Mapping[str, Value], name: str) -> ParameterValue | None:
    """The value of a name, a dict where it is the node's or `/`; None where there is nothing."""
    if name == "/":
        return {NODE.strip("/"): {**values}}
    if name == NODE:
        return {**values}
    return values.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None


def with_values(values: Mapping[str, Value], given: Mapping[str, ParameterValue]) -> Mapping[str, Value]:
    """The values with these set. Raises NotFound, and Refused with the node's words for the first that it refuses."""
    changed = dict(values)
    for name, value in given.items():
        if not name.startswith(_PREFIX):
            raise NotFound(f"the parameter {name} belongs to no node: those of the rover begin with {_PREFIX}")
        short = name.removeprefix(_PREFIX)
        if short not in PARAMETERS:
            raise _refusal(name, f"{short} is not declared")
        fit = _fit(name, value)
        if (problem := problem_of(short, fit)) is not None:
            raise _refusal(name, problem)
        changed[short] = cast(Value, fit)
    return changed


def refuse_deletion(names: Sequence[str]) -> None:
    """Raises Refused for a parameter that is there, which its node keeps, and NotFound for any other."""
    for name in names:
        if name not in GRAPH_PARAMETERS:
            raise NotFound(f"there is no parameter {name}")
        raise _refusal(name, "it was declared by its node, which keeps it")


def _fit(name: str, value: ParameterValue) -> ParameterValue:
    """The value in the type that is declared, where it fits; the node judges all others."""
    descriptor = GRAPH_PARAMETERS[name].descriptor
    fit = None if descriptor is None or descriptor.type is None else coerce(value, descriptor.type)
    return value if fit is None else fit


def _refusal(name: str, words: str) -> Refused:
    return Refused(f"{NODE} refuses the parameter {name}", words=words, sent=Sent.YES)
