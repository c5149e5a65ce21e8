"""Motion: the sequence of pictures that a resource offers as a stream."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from rosld.adapters.base import Watch


@dataclass(frozen=True, slots=True)
class Motion:
    """A source of pictures: `watch` calls back whenever there may be a new one, `newest` gives it as a file.

    `newest` gives None where there is none that was not given before, or none can be drawn.
    """

    media_type: str
    watch: Callable[[Callable[[], None]], Awaitable[Watch]]
    newest: Callable[[], Awaitable[bytes | None]]
