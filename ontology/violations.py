"""Violations: where and why a body does not fit the expected type."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TypeAlias

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.coercion import Misfit

Path: TypeAlias = "tuple[Path, str] | None"
"""The path from the message to a field, innermost last: (((None, "linear"), "x")); converted to text only if needed."""

_MAX_VIOLATIONS = 20
_MAX_TEXT = 120


class Violation(Struct, frozen=True):
    """A value that does not fit.

    `path` is that of the field (`linear.x`, "" for the message), followed by the expected and the actual value
    (shortened, None if missing). For violations of a SHACL shape, the rest is its validation result (SHACL 1.0 section
    3.6.2): `term` is the value, `predicate` the result's path, `quote` the shape's own message, text by third parties.
    """

    path: str
    message: str
    value: str | None = None
    component: NamedNode | None = None
    shape: NamedNode | None = None
    focus: NamedNode | BlankNode | None = None
    predicate: NamedNode | None = None
    term: NamedNode | BlankNode | Literal | None = None
    severity: NamedNode | None = None
    quote: str | None = None

    @property
    def with_quote(self) -> str:
        """The expected value, followed by the shape's message as a quotation."""
        return f"{self.message} ({json.dumps(self.quote, ensure_ascii=False)})" if self.quote else self.message


def violations_text(violations: Iterable[Violation]) -> str:
    """Return violations as text without a full stop."""
    return "; ".join(f"{each.path}: {each.message}" if each.path else each.message for each in violations)


class LoweringError(ValueError):
    """A body that is no message of the type, with some or all of its `violations`.

    `about` are URLs of the resources that the violations mention, for redaction.
    """

    def __init__(self, *violations: Violation, about: tuple[str, ...] = ()) -> None:
        super().__init__(violations_text(violations))
        self.violations = violations
        self.about = about

    def __reduce__(self) -> tuple[object, ...]:
        """Make the error picklable, for worker processes."""
        return LoweringError, self.violations


class Findings:
    """Collector of violations; the twentieth raises LoweringError."""

    def __init__(self) -> None:
        self.violations: list[Violation] = []

    def add(self, path: Path, words: str, value: object = None) -> None:
        """Add a violation.

        Raises LoweringError with all of them once there are too many.
        """
        self.violations.append(Violation(path_text(path), words, brief_value(value)))
        if len(self.violations) >= _MAX_VIOLATIONS:
            raise LoweringError(*self.violations)

    def misfit(self, path: Path, misfit: Misfit) -> None:
        """Add a misfit as a violation at (or below) `path`."""
        self.add((path, misfit.path) if misfit.path else path, misfit.words, misfit.value)


def path_text(path: Path) -> str:
    """Return the path as text."""
    steps: list[str] = []
    while path is not None:
        path, step = path
        steps.append(step)
    return ".".join(reversed(steps))


def brief_value(value: object) -> str | None:
    """Return a short text of a value for people; None for nothing."""
    if value is None:
        return None
    text = json.dumps(value, ensure_ascii=False, default=str) if isinstance(value, bool | list | dict) else str(value)
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= _MAX_TEXT else text[: _MAX_TEXT - 1] + "…"
