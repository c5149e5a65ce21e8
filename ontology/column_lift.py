"""Lifting of many messages of one type at once, when only numbers are needed.

A compiled lifter runs once on a probe message, which records the fields that the lifter reads and returns a unique mark
for each. The result is a template: columns of numbers replace its marks for each message.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import starmap
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.model import STRINGS, Message, MessageType, Nested, Primitive
from rosld.ontology.compile import TIME
from rosld.ontology.document import Envelope
from rosld.ontology.lift import Lifter
from rosld.ontology.literals import date_time, scalar_texts
from rosld.ontology.vocab import rdf, ros, xsd

_DOCUMENT = "urn:x-rosld-document"
_SEQUENCE = 987654321987654321
_SINGLE = 1 << 23
"""The first mark of a float32, which cannot contain text; integers of this size are exact."""


_DATATYPE = re.compile(rf'"\^\^<{re.escape(xsd.iri)}([A-Za-z]+)>')
_STAMP = 876_543_210
"""The first mark of the seconds of a stamp; that of the nanoseconds follows."""
_NO_NUMBERS = frozenset(each.value for each in (ros.sentBy, ros.elidedLength, ros.bytes, rdf.first, rdf.rest))
"""Predicates that need more than numbers."""


class _NotNumbers(Exception):
    """Values other than numbers are needed."""


class ColumnLifter:
    """Writer of messages as N-Triples, as a partial lifter: `paths` are the numbers that it needs from each message."""

    def __init__(
        self,
        parts: Sequence[str],
        marks: Sequence[str],
        paths: Mapping[str, tuple[str, ...]],
        stamps: Mapping[str, str],
        endings: Mapping[str, tuple[str, str]],
    ) -> None:
        """`stamps` are the marks of the nanoseconds of stamps by those of the seconds.

        `endings` are those of literals of floats by their marks, first as written, then as stored.
        """
        self.paths = list(paths.values())
        self._stamps = stamps
        self._endings = endings
        self._format = "%s".join(part.replace("%", "%%") for part in parts)
        self._marks = marks
        self._names = list(paths)

    def ntriples(
        self,
        documents: Sequence[str],
        times_ns: Sequence[int],
        sequences: Sequence[int],
        columns: Sequence[NDArray[Any]],
    ) -> str | None:
        """Return the lines of messages, each with its document, time of receipt, sequence number, and numbers.

        None for messages that differ in whether they have a stamp.
        """
        values: dict[str, Sequence[object]] = {
            name: scalar_texts(cast("Any", column)) for name, column in zip(self._names, columns, strict=True)
        }
        for name, (written, stored) in self._endings.items():
            texts = cast("Sequence[str]", values[name])
            values[name] = [each + (stored if each[-2:] == ".0" or "e" in each else written) for each in texts]
        for seconds, nanoseconds in self._stamps.items():
            pair = [columns[self._names.index(each)].tolist() for each in (seconds, nanoseconds)]
            stamps = [*zip(*pair, strict=True)]
            if (0, 0) in stamps:
                return None
            values[f"stamp {seconds}"] = [*starmap(date_time, stamps)]
        values[_DOCUMENT] = documents
        if "received" in self._marks:
            values["received"] = [date_time(0, each) for each in times_ns]
        if "sequence" in self._marks:
            values["sequence"] = sequences
        return "".join(map(self._format.__mod__, zip(*(values[mark] for mark in self._marks), strict=True)))


def column_lifter(
    lifter: Lifter,
    only: frozenset[str],
    topic: str,
    node: str,
    reshape: Callable[[str, str], str] = lambda text, message: text,
    *,
    datatype: Callable[[str], str] = xsd.iri.__add__,
    simulated_time: bool = False,
) -> ColumnLifter | None:
    """Return the lifter of many messages, with the link from their topic if needed; None if it needs more than numbers.

    `lifter` writes the statements with the predicates `only`; `node` is the fragment of the message (`#message`).
    `reshape` changes the text of a message, given its IRI. Literals that the store would change have another
    `datatype`, given its local name in XSD: integers of other types than xsd:integer, and floats with an exponent or
    without decimals. With `simulated_time` stamps are not times.
    """
    has_stamps = ros.dateTime.value in only
    if not only.isdisjoint(_NO_NUMBERS) or (has_stamps and simulated_time):
        return None
    schema = lifter.schema
    probe = _Probe(schema.types, schema.type, (), {}, has_stamps=has_stamps)
    try:
        text = lifter.ntriples(cast("Message", probe), _DOCUMENT, node, envelope=Envelope(0, _SEQUENCE))
    except _NotNumbers:
        return None
    link = f"<{topic}> <{ros.past.value}> <{_DOCUMENT}{node}> .\n" if ros.past.value in only else ""
    text = f"{link}{reshape(text, _DOCUMENT + node)}"
    stamps = {each: each + 1 for each in probe.found if isinstance(each, int) and each + 1 in probe.found}
    marks = {
        _DOCUMENT: _DOCUMENT,
        date_time(0, 0): "received",
        str(_SEQUENCE): "sequence",
        **{date_time(*each): f"stamp {each[0]}" for each in stamps.items()},
        **{_mark_text(mark): str(mark) for mark in probe.found},
    }
    parts: list[str] = []
    order: list[str] = []
    at = 0
    for match in re.finditer("|".join(map(re.escape, marks)), text):
        parts.append(text[at : match.start()])
        order.append(marks[match[0]])
        at = match.end()
    parts.append(text[at:])
    endings: dict[str, tuple[str, str]] = {}
    for place, mark in enumerate(order, 1):
        if (found := _DATATYPE.match(parts[place])) and found[1] not in ("integer", "dateTime"):
            stored = f'"^^<{datatype(found[1])}>'
            is_float = found[1] in ("float", "double")
            parts[place] = ("" if is_float else stored) + parts[place][found.end() :]
            if is_float:
                endings[mark] = found[0], stored
    used = {f"stamp {seconds}": (seconds, nanoseconds) for seconds, nanoseconds in stamps.items()}
    stamps = dict(used[mark] for mark in used if mark in order)
    needed = {*order, *map(str, (*stamps, *stamps.values()))}
    paths = {str(mark): path for mark, path in probe.found.items() if str(mark) in needed}
    return ColumnLifter(parts, order, paths, {str(each): str(after) for each, after in stamps.items()}, endings)


def shorten_paths(text: str, message: str, paths: Mapping[str, Sequence[str]], kept: frozenset[str]) -> str:
    """Return the N-Triples of a message with one statement for each path from it; the predicate is the path's name.

    All other statements are left out, except those with the predicates `kept`.
    """
    objects: dict[tuple[str, str], list[str]] = {}
    lines: list[str] = []
    for line in text.split("\n"):
        if line:
            subject, predicate, rest = line.split(" ", 2)
            objects.setdefault((subject, predicate), []).append(rest[:-2])
            if predicate[1:-1] in kept:
                lines.append(line)
    for name, steps in paths.items():
        nodes = [f"<{message}>"]
        for step in steps:
            nodes = [each for node in nodes for each in objects.get((node, f"<{step}>"), ())]
        lines += (f"<{message}> <{name}> {node} ." for node in nodes)
    return "".join(f"{line}\n" for line in lines)


def _mark_text(mark: float | str) -> str:
    """Return a mark as a lifter writes it: a string includes the quotes of JSON."""
    if isinstance(mark, int):
        return str(mark)
    return f'"{mark}"' if isinstance(mark, str) else scalar_texts(np.array([mark], np.float32))[0]


class _Probe:
    """A message that returns and records a mark for each number. Raises _NotNumbers for other values."""

    def __init__(
        self,
        types: Mapping[str, MessageType],
        kind: MessageType,
        path: tuple[str, ...],
        found: dict[float | str, tuple[str, ...]],
        *,
        has_stamps: bool = False,
    ) -> None:
        self.found = found
        self._has_stamps = has_stamps
        self._types = types
        self._kind = kind
        self._path = path

    def __getattr__(self, attribute: str) -> object:
        field = next((each for each in self._kind.fields if each.attribute == attribute), None)
        if field is None:
            raise AttributeError(attribute)
        path = (*self._path, field.name)
        if isinstance(field.type, Nested):
            if self._has_stamps and field.type.name == TIME:
                return self._stamp(path)
            kind = self._types[field.type.name]
            return _Probe(self._types, kind, path, self.found, has_stamps=self._has_stamps)
        if not isinstance(field.type, Primitive) or field.type.name in STRINGS or field.type.name == "bool":
            raise _NotNumbers
        number = len(self.found)
        mark = float(_SINGLE + number) if field.type.name == "float32" else f"@{number}@"
        self.found[mark] = path
        return mark

    def _stamp(self, path: tuple[str, ...]) -> SimpleNamespace:
        """Return a stamp whose marks are integers, so that it has a dateTime."""
        seconds = _STAMP + 2 * len(self.found)
        self.found[seconds], self.found[seconds + 1] = (*path, "sec"), (*path, "nanosec")
        return SimpleNamespace(sec=seconds, nanosec=seconds + 1)
