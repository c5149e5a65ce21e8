"""Whether nodes took the values that their parameters were set to: they may take another one than was asked for."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.adapters.model import ParameterValue, RosError
from rosld.server.robot.audited_adapter import AuditedAdapter


async def has_other_values(adapter: AuditedAdapter, asked: Mapping[str, ParameterValue], *, deadline: float) -> bool:
    """Whether a node has another value than was asked for.

    Only parameters that nodes declare are read again: all others are kept as they are set. What cannot be read now was
    set all the same.
    """
    parameters = adapter.graph.parameters
    declared = [name for name in asked if name in parameters and parameters[name].descriptor is not None]
    if not declared:
        return False
    try:
        made = await adapter.get_parameters(declared, deadline=deadline)
    except RosError:
        return False
    return any(made[name] != asked[name] for name in declared if name in made)
