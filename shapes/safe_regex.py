"""Safe regular expressions: patterns of clients, accepted only where their matching time is bounded.

Python's `re` backtracks: on some texts some patterns need a time that grows with a power of the text's length, or
doubles with each character, and nothing can stop them. So a pattern is looked at first. A repetition whose turns could
be told apart in several ways is refused; of the others the power is counted, and with it how long a text may be.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

_parser: Any = importlib.import_module("re._parser" if sys.version_info >= (3, 11) else "sre_parse")

_STEPS = 30_000_000
_MAX_PATTERN = 2000
_SHORTEST_TEXT = 64
_MANY = 8
_BEYOND = 256
_ALL = frozenset(range(_BEYOND + 1))
_FLAGS = {"i": re.IGNORECASE, "m": re.MULTILINE}
_REPEATS = ("MAX_REPEAT", "MIN_REPEAT", "POSSESSIVE_REPEAT")

_Characters = frozenset[int]
"""The characters below 256, and 256 for all beyond."""


@dataclass(frozen=True, slots=True)
class SafePattern:
    """A pattern that may be searched for in texts of up to `longest` characters."""

    text: str
    regex: re.Pattern[str]
    max_length: int

    def is_found_in(self, text: str) -> bool:
        """Whether it matches somewhere in a text; a text that is too long to try counts as none."""
        return len(text) <= self.max_length and self.regex.search(text) is not None


def compile_pattern(text: str, flags: str = "") -> SafePattern:
    """The pattern written as `text`, with SHACL's flags (4.4.3). Raises ValueError for one that cannot be taken."""
    if len(text) > _MAX_PATTERN:
        raise ValueError(f"the pattern {text[:40]!r}... is longer than {_MAX_PATTERN} characters")
    if strange := set(flags.lower()) - _FLAGS.keys():
        raise ValueError(f"the flag {min(strange)!r} of the pattern {text!r} is not known here: use i or m")
    options = re.RegexFlag(0)
    for flag in flags.lower():
        options |= _FLAGS[flag]
    try:
        regex = re.compile(text, options)
        steps = _Reader(bool(regex.flags & re.IGNORECASE), text).steps(_parser.parse(text, options))
    except (re.error, RecursionError, OverflowError) as error:
        raise ValueError(f"{text[:200]!r} is no regular expression: {error}") from error
    power, ways = _effort(steps, free=not (steps and steps[0].start) or bool(regex.flags & re.MULTILINE))
    longest = int((_STEPS // ways) ** (1 / power)) if power > 1 or ways > 1 else sys.maxsize
    if longest < _SHORTEST_TEXT:
        raise ValueError(f"the pattern {text!r} would take too long: too many of its parts can match the same text")
    return SafePattern(text, regex, longest)


class _Step(NamedTuple):
    """A part of a sequence: what it may take, what it may begin with, whether it must take something.

    `varies`: it may take more or less. `many`: that may be very many. `ways`: else, in how many ways it may match one
    text at most. `vague`: the next character does not tell which of its branches to take. `start`: nothing can come
    before it.
    """

    takes: _Characters
    first: _Characters
    needed: bool
    varies: bool = False
    many: bool = False
    ways: int = 1
    vague: bool = False
    start: bool = False


class _Reader:
    """Reads what `re` has parsed."""

    def __init__(self, ignore_case: bool, text: str) -> None:
        self.ignore_case = ignore_case
        self.text = text

    def steps(self, parsed: Iterable[Any]) -> list[_Step]:
        """The steps of a sequence."""
        return [step for op, value in parsed for step in self.step(str(op), value)]

    def step(self, op: str, value: Any) -> list[_Step]:
        if op in ("LITERAL", "NOT_LITERAL", "ANY", "IN"):
            characters = self.characters(op, value)
            return [_Step(characters, characters, True)]
        if op in _REPEATS:
            return self.repeat(*value)
        if op == "SUBPATTERN":
            return self.steps(value[3])
        if op == "ATOMIC_GROUP":
            return self.steps(value)
        if op == "BRANCH":
            return [self.branch([self.steps(each) for each in value[1]])]
        if op == "AT":
            return [_Step(frozenset(), frozenset(), False, start=str(value) in ("AT_BEGINNING", "AT_BEGINNING_STRING"))]
        if op in ("ASSERT", "ASSERT_NOT"):
            return [each._replace(needed=False) for each in self.steps(value[1])]
        raise ValueError(f"the pattern {self.text!r} refers back to what it matched, which could take for ever")

    def repeat(self, least: int, limit: int, parsed: Any) -> list[_Step]:
        body = self.steps(parsed)
        limit = int(limit)
        if least == limit <= 1:
            return body * limit
        whole = _joined(body)
        if limit > 1 and (whole.vague or (whole.varies and not _separated(body))):
            raise ValueError(
                f"the pattern {self.text!r} could take for ever on some texts: in a repetition within a repetition, "
                "let each turn begin or end with a character that is nowhere else in it"
            )
        varies = least != limit
        many = whole.many or (varies and limit >= _MANY)
        ways = min(whole.ways * (1 if many else limit - least + 1), _STEPS)
        return [
            whole._replace(
                needed=whole.needed and least > 0, varies=varies or whole.varies, many=many, ways=ways,
                start=whole.start and least > 0,
            )
        ]  # fmt: skip

    def branch(self, branches: Sequence[list[_Step]]) -> _Step:
        """One of several: told apart by the next character, or not."""
        wholes = [_joined(each) for each in branches]
        needed = all(each.needed for each in wholes)
        vague = sum(not each.needed for each in wholes) > 1 or any(
            not one.first.isdisjoint(other.first) for place, one in enumerate(wholes) for other in wholes[:place]
        )
        return _Step(
            frozenset().union(*(each.takes for each in wholes)),
            frozenset().union(*(each.first for each in wholes)),
            needed,
            varies=not needed or any(each.varies for each in wholes),
            many=any(each.many for each in wholes),
            ways=min(max(each.ways for each in wholes) * (len(wholes) if vague or not needed else 1), _STEPS),
            vague=vague or any(each.vague for each in wholes),
            start=all(each.start for each in wholes),
        )

    def characters(self, op: str, value: Any) -> _Characters:
        if op == "ANY":
            return _ALL
        if op == "IN":
            return self.any_of(value)
        found = self.cased({min(value, _BEYOND)})
        # What is beyond is one class here, so that leaving out one of them leaves the class.
        return found if op == "LITERAL" else (_ALL - found) | {_BEYOND}

    def any_of(self, items: Iterable[Any]) -> _Characters:
        found: set[int] = set()
        negated = False
        for op, value in items:
            match str(op):
                case "NEGATE":
                    negated = True
                case "LITERAL":
                    found.add(min(value, _BEYOND))
                case "RANGE":
                    found.update(range(value[0], min(value[1], _BEYOND) + 1), [_BEYOND] if value[1] >= _BEYOND else [])
                case _:
                    found |= _CATEGORIES[str(value)]
        if negated:
            return (_ALL - (self.cased(found) - {_BEYOND})) | {_BEYOND}
        return self.cased(found)

    def cased(self, characters: Iterable[int]) -> _Characters:
        if not self.ignore_case:
            return frozenset(characters)
        texts = [chr(each) for each in characters if each < _BEYOND]
        both = {ord(other) for text in texts for other in (text, *text.lower(), *text.upper())}
        return frozenset({min(each, _BEYOND) for each in both} | set(characters) | {_BEYOND})


def _category(escape: str) -> _Characters:
    return frozenset(each for each in range(_BEYOND) if re.match(escape, chr(each))) | {_BEYOND}


_CATEGORIES = {
    f"CATEGORY_{'NOT_' if escape.isupper() else ''}{name}": _category("\\" + escape)
    for name, escapes in {"DIGIT": "dD", "WORD": "wW", "SPACE": "sS"}.items()
    for escape in escapes
}


def _joined(steps: Sequence[_Step]) -> _Step:
    """A sequence as one step."""
    first: frozenset[int] = frozenset()
    for step in steps:
        first |= step.first
        if step.needed:
            break
    ways = 1
    for step in steps:
        ways = min(ways * step.ways, _STEPS)
    return _Step(
        frozenset().union(*(step.takes for step in steps)),
        first,
        any(step.needed for step in steps),
        varies=any(step.varies for step in steps),
        many=any(step.many for step in steps),
        ways=ways,
        vague=any(step.vague for step in steps),
        start=bool(steps) and steps[0].start,
    )


def _separated(body: Sequence[_Step]) -> bool:
    """Whether each turn of a repetition begins, or ends, with a character that is nowhere else in it.

    There is only one way to go in between, too.
    """
    varying = [(place, step) for place, step in enumerate(body) if step.varies]
    for place, one in varying:
        if any(_share(one, other, body[place + 1 : at]) for at, other in varying if at > place):
            return False
    return any(
        edge.needed and not edge.varies and all(edge.takes.isdisjoint(step.takes) for step in rest)
        for edge, rest in ((body[0], body[1:]), (body[-1], body[:-1]))
    )


def _effort(steps: Sequence[_Step], *, free: bool) -> tuple[int, int]:
    """With which power of the text's length the time may grow, and by which factor beside.

    How many repetitions, and in how many ways the rest, can share one stretch of it. Where the match may begin anywhere
    (`free`), that is one more repetition, of anything.
    """
    chain = [(-1, _Step(_ALL, _ALL, False), 1, 1)] if free else []
    for place, step in enumerate(steps):
        if step.many or step.ways > 1:
            before = [(power, ways) for at, other, power, ways in chain if _share(other, step, steps[at + 1 : place])]
            power = max((power for power, _ in before), default=0) + step.many
            ways = max((ways for _, ways in before), default=1) * step.ways
            chain.append((place, step, power, min(ways, _STEPS)))
    return max((power for *_, power, _ in chain), default=1) or 1, max((ways for *_, ways in chain), default=1)


def _share(one: _Step, other: _Step, between: Sequence[_Step]) -> bool:
    """Whether two steps can share one stretch of text: nothing needed between them stands in the way."""
    shared = one.takes & other.takes
    return bool(shared) and not any(step.needed and step.takes.isdisjoint(shared) for step in between)
