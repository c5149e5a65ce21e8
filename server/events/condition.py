"""Conditions on a value in plain JSON (`data >= 300 and not status = 'off'`): parsed and evaluated. Pure.

condition   = conjunction *( "or" conjunction )
conjunction = negation *( "and" negation )
negation    = "not" negation / "(" condition ")" / comparison
comparison  = path ( "=" / "==" / "!=" / "<" / "<=" / ">" / ">=" ) literal
path        = name *( "." name / "[" index "]" )
literal     = number / "true" / "false" / "null" / text in quotes of either kind
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from typing import TypeAlias

from msgspec import Struct, field

MAX_LENGTH = 500
"""Maximum number of characters of a condition."""
MAX_DEPTH = 20
"""Maximum nesting of parentheses and negations."""
WHOLE = "value"
"""Name of a value that is not an object."""
_MAX_NAMES = 30
"""Maximum number of field names in an error message."""

Value: TypeAlias = "bool | int | float | str | list[Value] | dict[str, Value] | None"
"""Plain JSON."""
Literal: TypeAlias = "bool | int | float | str | None"
Step: TypeAlias = "str | int"
"""The name of a field, or the index of an element."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?![\w.]))"
    r"|(?P<name>[^\W\d][\w-]*)"
    r"|'(?P<single>[^']*)'"
    r'|"(?P<double>[^"]*)"'
    r"|(?P<sign>==|!=|<=|>=|[=<>().\[\]]))"
)
_COMPARATORS: Mapping[str, Callable[[float, float], bool]] = {
    "=": operator.eq, "==": operator.eq, "!=": operator.ne,
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
_EQUALITY = frozenset({"=", "==", "!="})
_WORDS: Mapping[str, Literal] = {"true": True, "false": False, "null": None}
_RESERVED = frozenset({"and", "or", "not", *_WORDS})
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|NaN|-?INF", re.ASCII)
"""Numbers that are strings in plain JSON, which lacks them or whose readers would lose digits."""
_TYPED = frozenset({"@value", "@type"})
"""Members of an object that represents a parameter value without a JSON form."""


class ConditionError(ValueError):
    """A condition is malformed, or can never hold for a value."""


class Comparison(Struct, frozen=True):
    """A field compared with a literal."""

    path: tuple[Step, ...]
    comparator: str
    literal: Literal

    def holds(self, value: Value) -> bool:
        """Whether the comparison is true; a missing value, or one of another type, is unequal and unordered."""
        found = _at(self.path, value)
        if found is _NOWHERE:
            return False
        assert not isinstance(found, _Nowhere)
        left, right = (_as_number(found), self.literal) if _is_number(self.literal) else (found, self.literal)
        if _kind(left) != _kind(right):
            return self.comparator == "!="
        if self.comparator not in _EQUALITY and not _is_number(right):
            return isinstance(left, str) and isinstance(right, str) and _in_order(self.comparator, left, right)
        if _is_number(left) and _is_number(right):
            assert isinstance(left, int | float)
            assert isinstance(right, int | float)
            return _COMPARATORS[self.comparator](left, right)
        return (left == right) is (self.comparator != "!=")

    def check(self, value: Value) -> None:
        """Raise ConditionError if the comparison can never be true for such a value: no such field, or another type."""
        found = _require(self.path, value)
        if isinstance(found, _Nowhere) or found is None or self.literal is None:
            return
        written = _write(self.path)
        if isinstance(found, dict | list):
            raise ConditionError(f"{written} is {_kind(found)}; compare a part of it: {_parts(found)}")
        is_numeric = _is_number(self.literal) and _is_number(_as_number(found))
        if not is_numeric and _kind(found) != _kind(self.literal):
            raise ConditionError(
                f"{written} is {_kind(found)}, now {_brief(found)}: compare it with a value of that type"
            )
        if isinstance(found, bool) and self.comparator not in _EQUALITY:
            raise ConditionError(f"{written} is true or false: compare it with = or !=")


class Negation(Struct, frozen=True):
    """Negation of a condition."""

    of: Condition

    def holds(self, value: Value) -> bool:
        """Whether the negated condition is false."""
        return not self.of.holds(value)

    def check(self, value: Value) -> None:
        """Raise ConditionError as `Comparison.check` does."""
        self.of.check(value)


class Combination(Struct, frozen=True):
    """Conjunction or disjunction of conditions."""

    parts: tuple[Condition, ...]
    combine: Callable[[Iterator[bool]], bool]

    def holds(self, value: Value) -> bool:
        """Whether the combination is true."""
        return self.combine(part.holds(value) for part in self.parts)

    def check(self, value: Value) -> None:
        """Raise ConditionError as `Comparison.check` does."""
        for part in self.parts:
            part.check(value)


Condition: TypeAlias = "Comparison | Negation | Combination"


def named_members(condition: Condition) -> frozenset[str]:
    """Return the outermost members that a condition names."""
    match condition:
        case Comparison(path=(name, *_)):
            return frozenset({str(name)})
        case Negation(of=inner):
            return named_members(inner)
        case Combination(parts=parts):
            return frozenset().union(*map(named_members, parts))
    raise AssertionError(f"{condition!r} is not a condition")


def parse_condition(text: str) -> Condition:
    """Parse a condition. Raises ConditionError with the error and its position."""
    if len(text) > MAX_LENGTH:
        raise ConditionError(f"it has {len(text)} characters: send at most {MAX_LENGTH}")
    parser = _Parser(_tokens(text))
    found = parser.condition(0)
    parser.require_end()
    return found


# Values


class _Nowhere(Struct, frozen=True):
    """Value of a missing field."""


_NOWHERE = _Nowhere()


def _at(path: tuple[Step, ...], value: Value) -> Value | _Nowhere:
    try:
        return _require(path, value)
    except ConditionError:
        return _NOWHERE


def _require(path: tuple[Step, ...], value: Value) -> Value | _Nowhere:
    """Return the value of a field, nowhere below null. Raises ConditionError if there is no such field."""
    if value is None and path != (WHOLE,):
        return _NOWHERE
    found: Value = value if isinstance(value, dict) else {WHOLE: value}
    for number, step in enumerate(path):
        if found is None:
            return _NOWHERE
        if isinstance(found, list) and isinstance(step, int):
            if step >= len(found):
                return _NOWHERE
            found = found[step]
        elif isinstance(found, dict) and isinstance(step, str) and step in found:
            found = found[step]
        else:
            where = f" in {_write(path[:number])}" if number else ""
            raise ConditionError(f"there is no {_write((step,))}{where}: {_parts(found)}")
    return found["@value"] if isinstance(found, dict) and found.keys() == _TYPED else found


def _parts(value: Value) -> str:
    """Return the parts of a value in words, for an error."""
    names = _names(value)
    return f"there are {', '.join(names)}" if names else "it has no parts"


def _names(value: Value) -> list[str]:
    if isinstance(value, dict):
        names = sorted(value)
    else:
        names = [f"[0] to [{len(value) - 1}]"] if isinstance(value, list) and value else []
    return [*names[:_MAX_NAMES], *(("...",) if len(names) > _MAX_NAMES else ())]


def _write(path: tuple[Step, ...]) -> str:
    """Return a path in the syntax of conditions."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _as_number(value: Value) -> Value:
    """Return the number in a string that represents one in plain JSON, else the value itself."""
    if not isinstance(value, str) or len(value) > _MAX_DIGITS or not _NUMBER.fullmatch(value):
        return value
    return int(value) if value.removeprefix("-").isdigit() else float(value)


_MAX_DIGITS = 30


def _kind(value: object) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "a boolean"
        case int() | float():
            return "a number"
        case str():
            return "text"
        case list():
            return "an array"
        case _:
            return "an object"


def _in_order(comparator: str, left: str, right: str) -> bool:
    """Whether texts are in this order, by code points."""
    return {"<": left < right, "<=": left <= right, ">": left > right, ">=": left >= right}[comparator]


def _brief(value: Literal) -> str:
    return repr(value[:40]) if isinstance(value, str) else str(value).lower()


# Text


class _Token(Struct, frozen=True):
    """A word, a sign or a literal, with its position."""

    kind: str
    text: str
    at: int


def _tokens(text: str) -> tuple[_Token, ...]:
    found: list[_Token] = []
    at, end = 0, len(text.rstrip())
    while at < end:
        match = _TOKEN.match(text, at)
        if match is None:
            raise ConditionError(f"{text[at:].strip()[:20]!r} cannot be read; {_FORM}")
        kind = match.lastgroup
        assert kind is not None
        found.append(_Token("text" if kind in ("single", "double") else kind, match[kind], match.start(kind)))
        at = match.end()
    return tuple(found)


_FORM = "a condition looks like data >= 300 and status = 'on'"
_END = _Token("end", "", -1)


class _Parser(Struct):
    """The tokens, and the number of those read."""

    tokens: tuple[_Token, ...]
    read: int = field(default=0)

    def condition(self, depth: int) -> Condition:
        if depth > MAX_DEPTH:
            raise ConditionError(f"it is nested deeper than {MAX_DEPTH}")
        parts = [self._conjunction(depth)]
        while self._take("name", "or"):
            parts.append(self._conjunction(depth))
        return parts[0] if len(parts) == 1 else Combination(tuple(parts), any)

    def require_end(self) -> None:
        """Raise ConditionError if tokens are left."""
        if self._next is not _END:
            raise self._unexpected("and, or, or nothing more")

    def _conjunction(self, depth: int) -> Condition:
        parts = [self._negation(depth)]
        while self._take("name", "and"):
            parts.append(self._negation(depth))
        return parts[0] if len(parts) == 1 else Combination(tuple(parts), all)

    def _negation(self, depth: int) -> Condition:
        if self._take("name", "not"):
            if depth >= MAX_DEPTH:
                raise ConditionError(f"it is nested deeper than {MAX_DEPTH}")
            return Negation(self._negation(depth + 1))
        if self._take("sign", "("):
            found = self.condition(depth + 1)
            if not self._take("sign", ")"):
                raise self._unexpected("a closing parenthesis")
            return found
        return self._comparison()

    def _comparison(self) -> Condition:
        path = tuple(self._path())
        token = self._next
        if token.kind != "sign" or token.text not in _COMPARATORS:
            raise self._unexpected("one of =, !=, <, <=, > and >=")
        self.read += 1
        literal = self._literal()
        if token.text not in _EQUALITY and (literal is None or isinstance(literal, bool)):
            raise ConditionError(f"{_brief(literal)} has no order: compare it with = or !=")
        return Comparison(path, token.text, literal)

    def _path(self) -> Iterator[Step]:
        yield self._name()
        while True:
            if self._take("sign", "."):
                yield self._name()
            elif self._take("sign", "["):
                token = self._next
                if token.kind != "number" or not token.text.isdigit() or len(token.text) > _MAX_DIGITS:
                    raise self._unexpected("the index of an element, from 0")
                self.read += 1
                yield int(token.text)
                if not self._take("sign", "]"):
                    raise self._unexpected("a closing bracket")
            else:
                return

    def _name(self) -> str:
        token = self._next
        if token.kind != "name" or token.text in _RESERVED:
            raise self._unexpected("the name of a field")
        self.read += 1
        return token.text

    def _literal(self) -> Literal:
        token = self._next
        self.read += 1
        if token.kind == "text":
            return token.text
        if token.kind == "number":
            return _number(token.text)
        if token.kind == "name" and token.text in _WORDS:
            return _WORDS[token.text]
        self.read -= 1
        raise self._unexpected("a number, true, false, null, or text in quotes")

    @property
    def _next(self) -> _Token:
        return self.tokens[self.read] if self.read < len(self.tokens) else _END

    def _take(self, kind: str, text: str) -> bool:
        """Read the next token if it is this one; return whether it was."""
        token = self._next
        if (token.kind, token.text) != (kind, text):
            return False
        self.read += 1
        return True

    def _unexpected(self, wanted: str) -> ConditionError:
        token = self._next
        where = "at the end" if token is _END else f"at {token.text[:20]!r} (character {token.at + 1})"
        return ConditionError(f"expected {wanted} {where}; {_FORM}")


def _number(text: str) -> int | float:
    if text.lstrip("+-").isdigit():
        return int(text)
    found = float(text)
    if math.isinf(found):
        raise ConditionError(f"{text[:20]} is too large a number")
    return found
