"""Words: what names and sentences are searched by. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

_RUN = re.compile(r"[^\W\d_]+|\d+")


@lru_cache(maxsize=16384)
def words_of(text: str) -> tuple[str, ...]:
    """The words of a name or a sentence, in lower case, each once.

    `image_raw`, `BatteryState`, `IMUData` and `scan2` have two each.
    """
    return tuple(dict.fromkeys(word.casefold() for run in _RUN.findall(text) for word in _humps(run)))


def _humps(run: str) -> Iterator[str]:
    """The words of a run of letters: one begins with a capital after a small letter, or before one."""
    start = 0
    for index in range(1, len(run)):
        is_last_capital = run[index - 1].isupper() and run[index : index + 2].istitle() and len(run) > index + 1
        if run[index].isupper() and (run[index - 1].islower() or is_last_capital):
            yield run[start:index]
            start = index
    yield run[start:]
