"""Names similar to a missing one: with the same last segment or its words, allowing a few typing errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

from rosld.server.search.words import words_of

MAX_NEAR = 5
"""Maximum number of suggested names."""
_MAX_EDITS = 2
_MIN_PART = 3
"""Minimum number of characters of a segment that counts as a part of another."""
_MAX_COMPARED = 1000
"""Maximum number of edit distances computed: a robot may have thousands of segments that differ in a number."""
_BEYOND = _MAX_EDITS + 1
"""Distance of two segments if one begins with the other; names that only share words are further away."""
_MAX_WORDS = 8
"""Maximum number of words of a last segment that are searched."""


class NearNames:
    """Index of names for suggestions; names of containers end in a slash, as in URLs.

    Last segments are compared case-insensitively: a wrong namespace is as frequent as a typing error. Then follow names
    that have all words of the last segment, at least one of them in their own last segment. Each segment and word has a
    mask of its characters, so that few of thousands are compared.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._by_last: dict[str, list[str]] = {}
        self._by_word: dict[str, list[str]] = {}
        for name in names:
            self._by_last.setdefault(_last(name), []).append(name)
            for word in words_of(name):
                self._by_word.setdefault(word, []).append(name)
        self._masks = [(last, _mask(last)) for last in self._by_last]
        self._word_masks = [(word, _mask(word)) for word in self._by_word]

    def of(self, name: str, limit: int = MAX_NEAR) -> list[str]:
        """Return the names nearest to `name`, nearest first, without `name` itself."""
        wanted, home = _last(name), _home(name)
        mask, edits = _mask(wanted), max_edits(wanted)
        distances = self._with_words(words_of(_last_segment(name)))
        near = (
            last
            for last, other in self._masks
            if (mask ^ other).bit_count() <= 2 * edits or last.startswith(wanted) or wanted.startswith(last)
        )
        for last in islice(near, _MAX_COMPARED):
            distance = _distance(wanted, last, edits)
            if distance is not None:
                distances |= dict.fromkeys(self._by_last[last], distance)
        found = [(distance, _home(each) != home, len(each), each) for each, distance in distances.items()]
        return [each for *_, each in sorted(found) if each.rstrip("/") != name.rstrip("/")][:limit]

    def _with_words(self, wanted: Sequence[str]) -> dict[str, int]:
        """Return the distances of names that have all these words, with typing errors, and one in the last segment."""
        found: dict[str, int] = {}
        known: set[str] = set()
        for index, word in enumerate(wanted[:_MAX_WORDS]):
            mask, edits = _mask(word), max_edits(word)
            errors: dict[str, int] = {}
            for other, other_mask in self._word_masks:
                if (mask ^ other_mask).bit_count() > 2 * edits or (count := edit_distance(word, other, edits)) > edits:
                    continue
                known.add(other)
                for name in self._by_word[other]:
                    errors[name] = min(count, errors.get(name, count))
            beyond = _BEYOND + 1
            found = {
                name: found.get(name, beyond) + count for name, count in errors.items() if not index or name in found
            }
        return {name: far for name, far in found.items() if not known.isdisjoint(words_of(_last_segment(name)))}


def max_edits(word: str) -> int:
    """Return the maximum number of typing errors in a word: one per three characters, at most two."""
    return min(_MAX_EDITS, len(word) // 3)


def _distance(one: str, other: str, edits: int) -> int | None:
    """Return the distance of two last segments, or None if they are not similar."""
    distance = edit_distance(one, other, edits)
    if distance <= edits:
        return distance
    is_part = min(len(one), len(other)) >= _MIN_PART and (one.startswith(other) or other.startswith(one))
    return _BEYOND if is_part else None


def edit_distance(one: str, other: str, limit: int) -> int:
    """Return the number of insertions, deletions, replacements and swaps of neighbours, or any number above `limit`.

    This is the optimal string alignment distance; only the cells within `limit` of the diagonal are computed.
    """
    if abs(len(one) - len(other)) > limit:
        return limit + 1
    beyond = limit + 1
    before, last = [beyond] * (len(other) + 1), [min(column, beyond) for column in range(len(other) + 1)]
    for row, char in enumerate(one, 1):
        here = [beyond] * (len(other) + 1)
        here[0] = min(row, beyond)
        for column in range(max(1, row - limit), min(len(other), row + limit) + 1):
            cost = min(last[column - 1] + (char != other[column - 1]), last[column] + 1, here[column - 1] + 1)
            if row > 1 and column > 1 and char == other[column - 2] and one[row - 2] == other[column - 1]:
                cost = min(cost, before[column - 2] + 1)
            here[column] = min(cost, beyond)
        if min(here) > limit:
            return beyond
        before, last = last, here
    return last[-1]


def _last_segment(name: str) -> str:
    return name.rstrip("/").rpartition("/")[2]


def _last(name: str) -> str:
    return _last_segment(name).casefold()


def _home(name: str) -> str:
    return name.rstrip("/").rpartition("/")[0]


def _mask(word: str) -> int:
    """Return a bit for each character of a word: one edit changes at most two bits."""
    found = 0
    for char in word:
        found |= 1 << (ord(char) & 63)
    return found
