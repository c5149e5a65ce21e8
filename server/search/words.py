"""Words of names and of questions: splitting, stems, stop words, and whether a question asks or commands."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator
from functools import lru_cache
from string import ascii_lowercase
from typing import NamedTuple

_RUN = re.compile(r"[^\W\d_]+|\d+")


@lru_cache(maxsize=16384)
def words_of(text: str) -> tuple[str, ...]:
    """Return the words of a name or a sentence, in lower case, each once.

    `image_raw`, `BatteryState`, `IMUData` and `scan2` have two words each.
    """
    return tuple(dict.fromkeys(word.casefold() for run in _RUN.findall(text) for word in _humps(run)))


def _humps(run: str) -> Iterator[str]:
    """Yield the words of a run of letters: one begins with a capital after a lower-case letter, or before one."""
    start = 0
    for index in range(1, len(run)):
        is_last_capital = run[index - 1].isupper() and run[index : index + 2].istitle() and len(run) > index + 1
        if run[index].isupper() and (run[index - 1].islower() or is_last_capital):
            yield run[start:index]
            start = index
    yield run[start:]


_SUFFIX = re.compile(r"(?<=..)(?:ing|ers?|ed|es|(?<![su])s)$")


@lru_cache(maxsize=16384)
def stem(word: str) -> str:
    """Return a word without its English ending: `stopped`, `stops` and `stop` have the same stem."""
    if len(word) < 4 or not word.isascii():
        return word
    if word.endswith("ies"):
        return f"{word[:-3]}y"
    short = _SUFFIX.sub("", word)
    if len(short) > 3 and short[-1] == short[-2] and short != word and short[-1] not in "lsz":
        short = short[:-1]
    return short.removesuffix("e") if len(short) > 3 else short


MIN_CORRECTED = 5
"""Minimum number of letters of a word that may have a typing error."""


def corrections(word: str, *known: Container[str]) -> list[str]:
    """Return the known words that differ from a word by one letter, or by two that are swapped."""
    parts = [(word[:index], word[index:]) for index in range(len(word) + 1)]
    edits = {one + two[1:] for one, two in parts if two}
    edits |= {one + two[1] + two[0] + two[2:] for one, two in parts if len(two) > 1}
    edits |= {one + letter + rest for one, two in parts for letter in ascii_lowercase for rest in (two, two[1:])}
    return sorted(edit for edit in edits if any(edit in words for words in known))


MAX_WORDS = 8
MAX_CHARACTERS = 200
"""Maximum numbers of terms and characters of a query; `read_query` rejects more."""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_STOP_WORDS = _words(
    """a about actually am an and any anything are as at be been being but by can could current currently data did do
    does doing for from get gets getting give had has have how i if in information into is it its itself just let
    like make makes many may me much must my need no not now of on one or our out please robot show so some
    something such take tell than that the their them then these this those to too topic us use using value values
    very want was way we were what when which who will with would you your command commands info it's what's where's
    how's robot's"""
)
_ASKING = _words(
    "are did display does had has have how is list read see show tell was watch were what when where which who why"
)
_COMMANDING = _words(
    """activate adjust beep bring call cancel change charge close configure disable dock drive enable fly follow freeze
    go grab grasp halt hold lift limit lower make move navigate open pick play press publish put raise record reset
    return reverse rotate run say send set shut speak spin start stop switch toggle turn undock walk"""
)
_POLITE = _words("a can could i let like me my please robot the to us want we would you")
_HOW_TO = re.compile(r"\b(?:how (?:to|do i|do we|do you|can i|can we)|can i|command)\b")


class Query(NamedTuple):
    """What was asked: the words to search for, and those left out because they say little.

    `commands` is whether it wants something done (True) or asks for something to read (False), or None if it is open.
    """

    terms: tuple[str, ...]
    dropped: tuple[str, ...] = ()
    commands: bool | None = None


def read_query(text: str, phrases: Container[str] = ()) -> Query:
    """Return the query in a text, with `phrases` as single terms. Raises ValueError if it is too long."""
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"it has {len(text)} characters, but the limit is {MAX_CHARACTERS}")
    words = [word for each in text.casefold().split() if (word := each.strip("?!.,;:\"'()"))]
    terms = list[str]()
    while words:
        size = 2 if " ".join(words[:2]) in phrases else 1
        terms.append(" ".join(words[:size]))
        del words[:size]
    kept = [term for term in terms if term not in _STOP_WORDS] or terms
    if len(kept) > MAX_WORDS:
        raise ValueError(f"it has {len(kept)} words, but the limit is {MAX_WORDS}")
    dropped = [term for term in terms if term not in kept]
    return Query(tuple(dict.fromkeys(kept)), tuple(dict.fromkeys(dropped)), _commands(text.casefold()))


def _commands(text: str) -> bool | None:
    """Return whether a text wants something done (True), asks (False), or neither, by its first word that tells."""
    if _HOW_TO.search(text):
        return True
    first = next((word for word in words_of(text) if word not in _POLITE), "")
    return True if first in _COMMANDING else False if first in _ASKING else None
