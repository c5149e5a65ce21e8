"""What all forms have in common: their methods, and the pairs that they send."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

Method: TypeAlias = Literal["PUT", "POST", "PATCH", "DELETE"]
Pairs: TypeAlias = Sequence[tuple[str, str]]
