"""Parameter values: what a parameter server can hold."""

from __future__ import annotations

from datetime import datetime
from typing import TypeAlias

ParameterValue: TypeAlias = (
    "bool | int | float | str | bytes | datetime | list[ParameterValue] | dict[str, ParameterValue]"
)
"""A scalar, a list, or a dict (a tree of parameters, or within a list just a dict)."""
