"""Lifting of many messages of one type at once, when only numbers are needed.

A compiled lifter runs once on a probe message, which records the fields that the lifter reads and returns a unique mark
for each. The result is a template: columns of numbers replace its marks for each message.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model import STRINGS, Message, MessageType, Nested, Primitive
from rosld.ontology.document import Envelope
from rosld.ontology.lift import Lifter
from rosld.ontology.literals import date_time, scalar_texts
from rosld.ontology.vocab import rdf, ros

_DOCUMENT = "urn:x-rosld-document"
_SEQUENCE = 987654321987654321
_SINGLE = 1 << 23
"""The first mark of a float32, which cannot contain text; integers of this size are exact."""


_NO_NUMBERS = frozenset(
    each.value for each in (ros.dateTime, ros.sentBy, ros.elidedLength, ros.bytes, rdf.first, rdf.rest)
)
"""Predicates that need more than numbers."""


class _NotNumbers(Exception):
    """Values other than numbers are needed."""


class ColumnLifter:
    """Writer of messages as N-Triples, as a partial lifter: `paths` are the numbers that it needs from each message."""

    def __init__(self, parts: Sequence[str], marks: Sequence[str], paths: Mapping[str, tuple[str, ...]]) -> None:
        self.paths = list(paths.values())
        self._format = "%s".join(part.replace("%", "%%") for part in parts)
        self._marks = marks
        self._names = list(paths)

    def ntriples(
        self,
        documents: Sequence[str],
        times_ns: Sequence[int],
        sequences: Sequence[int],
        columns: Sequence[NDArray[Any]],
    ) -> str:
        """Return the lines of messages, each with its document, time of receipt, sequence number, and numbers."""
        values: dict[str, Sequence[object]] = {
            name: scalar_texts(cast("Any", column)) for name, column in zip(self._names, columns, strict=True)
        }
        values[_DOCUMENT] = documents
        if "received" in self._marks:
            values["received"] = [date_time(0, each) for each in times_ns]
        if "sequence" in self._marks:
            values["sequence"] = sequences
        return "".join(map(self._format.__mod__, zip(*(values[mark] for mark in self._marks), strict=True)))


def column_lifter(lifter: Lifter, only: frozenset[str], topic: str, node: str) -> ColumnLifter | None:
    """Return the lifter of many messages, including the link from their topic; None if it needs more than numbers.

    `lifter` writes the statements with the predicates `only`; `node` is the fragment of the message (`#message`).
    """
    if not only.isdisjoint(_NO_NUMBERS):
        return None
    schema = lifter.schema
    probe = _Probe(schema.types, schema.type, (), {})
    try:
        text = lifter.ntriples(cast("Message", probe), _DOCUMENT, node, envelope=Envelope(0, _SEQUENCE))
    except _NotNumbers:
        return None
    text = f"<{topic}> <{ros.past.value}> <{_DOCUMENT}{node}> .\n{text}"
    marks = {
        _DOCUMENT: _DOCUMENT,
        date_time(0, 0): "received",
        str(_SEQUENCE): "sequence",
        **{_mark_text(mark): str(mark) for mark in probe.found},
    }
    parts: list[str] = []
    order: list[str] = []
    at = 0
    for match in re.finditer("|".join(map(re.escape, marks)), text):
        parts.append(text[at : match.start()])
        order.append(marks[match[0]])
        at = match.end()
    return ColumnLifter([*parts, text[at:]], order, {str(mark): path for mark, path in probe.found.items()})


def _mark_text(mark: float | str) -> str:
    """Return a mark as a lifter writes it: a string includes the quotes of JSON."""
    return f'"{mark}"' if isinstance(mark, str) else scalar_texts(np.array([mark], np.float32))[0]


class _Probe:
    """A message that returns and records a mark for each number. Raises _NotNumbers for other values."""

    def __init__(
        self,
        types: Mapping[str, MessageType],
        kind: MessageType,
        path: tuple[str, ...],
        found: dict[float | str, tuple[str, ...]],
    ) -> None:
        self.found = found
        self._types = types
        self._kind = kind
        self._path = path

    def __getattr__(self, attribute: str) -> object:
        field = next((each for each in self._kind.fields if each.attribute == attribute), None)
        if field is None:
            raise AttributeError(attribute)
        path = (*self._path, field.name)
        if isinstance(field.type, Nested):
            return _Probe(self._types, self._types[field.type.name], path, self.found)
        if not isinstance(field.type, Primitive) or field.type.name in STRINGS or field.type.name == "bool":
            raise _NotNumbers
        number = len(self.found)
        mark = float(_SINGLE + number) if field.type.name == "float32" else f"@{number}@"
        self.found[mark] = path
        return mark
