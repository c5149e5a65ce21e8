"""Queries that only aggregate numbers of recorded messages, answered from statistics. Pure.

Such a query is evaluated over summaries instead of messages: a node with the same statements stands for many messages
of a topic in a recording. Where a message has a number, a summary has a node with the minimum, the maximum and the sum.
So the patterns stay as they are, and only the aggregates change: COUNT becomes the sum of the numbers of messages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from msgspec import Struct

from rosld.ontology.vocab import rdf, ros
from rosld.server.sparql.intervals import ANY_TIME, Interval, date_time_interval, split_parts
from rosld.server.sparql.syntax.expressions import calls_within, is_aggregate
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.syntax.tree import (
    Call,
    Constant,
    Expression,
    Group,
    Iri,
    Operand,
    Part,
    Pattern,
    Query,
    Reference,
    Value,
    Variable,
    strip_brackets,
    variables_in,
)

if TYPE_CHECKING:
    from rosld.server.sparql.past import PastQuery

COUNT, MINIMUM, MAXIMUM, TOTAL = (f"urn:x-rosld:summary:{each}" for each in ("count", "minimum", "maximum", "total"))
"""Predicates of summaries and of the nodes in place of their numbers."""
_STATISTICS = {"MIN": MINIMUM, "MAX": MAXIMUM, "SAMPLE": MINIMUM, "SUM": TOTAL, "AVG": TOTAL}
_PREFIX = "rosld_summary_"
_COUNT = f"?{_PREFIX}count"
_ZONE = re.compile("(?:Z|[+-][0-9]{2}:[0-9]{2})$")
_TURNED = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}


class SummaryQuery(Struct, frozen=True):
    """Query over summaries with the results of another query over messages.

    The messages have all `paths` (predicates from the message on, in any order), at their ends numbers if they are in
    `numbers`, and the classes at the ends of paths in `classes`. They were received within `time`, exactly.
    """

    text: str
    paths: tuple[tuple[str, ...], ...]
    numbers: tuple[tuple[str, ...], ...]
    classes: tuple[tuple[tuple[str, ...], str], ...]
    time: Interval


def summary_query(query: Query, past: PastQuery, types: str) -> SummaryQuery | None:
    """Return the query over summaries for a query over messages, None if it needs the messages themselves.

    `types` is the namespace of message types.
    """
    where = query.where
    if query.form != "SELECT" or where.children or where.filters or where.graph is not None or _PREFIX in query.text:
        return None
    if ros.convert.value in query.functions:  # it needs the unit of a variable
        return None
    messages = {each.object for each in where.patterns if each.predicates == frozenset({ros.past.value})}
    if len(messages) != 1 or len(past.selections(ANY_TIME)) != 1 or not past.is_linked:
        return None
    [message] = messages
    if not isinstance(message, Variable):
        return None
    found = _Message(where, message, types)
    if not found.is_understood:
        return None
    time = ANY_TIME
    edits: list[tuple[int, int, str]] = []
    added: dict[tuple[str, str], str] = {}
    calls = [call for each in query.expressions for call in calls_within(each.operand) if is_aggregate(call)]
    if not calls and not _is_distinct(query):
        return None
    for test in where.tests:
        names = variables_in(test)
        if names is None or not names.isdisjoint(found.inner):
            bound = _bound(test, found.times)
            if bound is not None:
                time = time.meet(bound)
                edits.append((test.start, test.end, "(true)"))
                continue
            extreme = None if calls or added else _extreme(test, found)  # two may be of different messages
            if extreme is None:
                return None
            variable, predicate = extreme
            added[variable.name[1:], predicate] = f"?{_PREFIX}0"
            edits.append((variable.start, variable.end, f"?{_PREFIX}0"))
    bindings = [*where.bindings, *((name, None) for name, _ in where.data)]
    for name, operand in bindings:
        used = frozenset({name}) | (frozenset() if operand is None else variables_in(operand) or found.inner)
        if not used.isdisjoint(found.inner):
            return None
    for call in calls:
        changed = _changed(call, query, found, added)
        if changed and _COUNT in changed:
            added[message.name, COUNT] = _COUNT
        if changed is None:
            return None
        if changed:
            edits.append((call.start, call.end, changed))
    if not _covers(query, found.inner, edits):
        return None
    lines = (f"?{subject} <{predicate}> {name} ." for (subject, predicate), name in added.items())
    edits.append((query.braces[0] + 1, query.braces[0] + 1, " " + " ".join(lines) + " "))
    text = query.text
    for start, end, piece in sorted(edits, reverse=True):
        text = text[:start] + piece + text[end:]
    numbers = {found.paths[name] for name, predicate in added if predicate != COUNT and name not in found.times}
    paths = tuple(sorted({*found.paths.values()}, key=len))
    return SummaryQuery(text, paths, tuple(sorted(numbers)), tuple(found.classes), time)


def _is_distinct(query: Query) -> bool:
    """Whether a SELECT returns different rows of variables that it names."""
    following = [token.text.upper() for token in query.tokens if token.start > query.start][:2]
    return following[0] == "DISTINCT" and following[1] != "*"


def _extreme(test: Operand, found: _Message) -> tuple[Reference, str] | None:
    """Return the variable of a number and its extreme that passes a test if any number of several messages does."""
    test = strip_brackets(test)
    compared = _comparison(test.parts) if isinstance(test, Expression) else None
    if compared is None or compared[2].kind is not Kind.NUMBER:
        return None
    variable, operator, _ = compared
    if variable.name[1:] not in found.ends - found.times:
        return None
    return variable, MINIMUM if operator.startswith("<") else MAXIMUM


class _Message:
    """Variables of a group that stand for a message and for what is in it."""

    def __init__(self, group: Group, message: Variable, types: str) -> None:
        self.paths: dict[str, tuple[str, ...]] = {}
        """Paths of fields from the message, by the variable at their ends."""
        self.times: set[str] = set()
        self.classes: list[tuple[tuple[str, ...], str]] = []
        self._types = types
        records = {each.subject for each in group.patterns if _is(each, ros.recordedMessage.value)}
        self._inner: dict[str, int] = {each.name: 1 for each in (message, *records) if isinstance(each, Variable)}
        self._is_known = all(isinstance(each, Variable) for each in records) and len(records) <= 1
        nodes: dict[str, tuple[str, ...]] = {message.name: ()}
        rest = [each for each in group.patterns if not _is(each, ros.past.value)]
        while taken := [each for each in rest if isinstance(each.subject, Variable) and each.subject.name in nodes]:
            rest = [each for each in rest if each not in taken]
            for each in taken:
                self._take(each, nodes)
        for each in rest:
            if each.subject in records:
                is_link = _is(each, ros.recordedMessage.value) and each.object == message
                self._is_known &= is_link or _is(each, ros.recordedIn.value)
            elif {each.subject, each.object, each.verb} & {*map(Variable, self._inner)}:
                self._is_known = False
        self.bound = {each.name for one in group.patterns for each in one[::2] if isinstance(each, Variable)}
        """All variables of patterns, which have a value in each solution."""
        self.inner = frozenset(self._inner)
        self.ends = self.times | {
            name for name, path in self.paths.items() if path not in {each[:-1] for each in self.paths.values()}
        }

    @property
    def is_understood(self) -> bool:
        """Whether each message has exactly one solution of the patterns about it."""
        return self._is_known and all(count == 1 for count in self._inner.values())

    def _take(self, pattern: Pattern, nodes: dict[str, tuple[str, ...]]) -> None:
        predicate = next(iter(pattern.predicates or ("",)))
        path = nodes[pattern.subject.name] if isinstance(pattern.subject, Variable) else ()
        if not _is(pattern, predicate):
            self._is_known = False
        elif predicate == rdf.type.value and isinstance(pattern.object, Iri):
            self.classes.append((path, pattern.object.value))
            self._is_known &= pattern.object.value.startswith(self._types)
        elif predicate == ros.recordedIn.value and not path:
            return
        elif not isinstance(pattern.object, Variable):
            self._is_known = False
        else:
            name = pattern.object.name
            self._inner[name] = self._inner.get(name, 0) + 1
            if predicate == ros.received.value and not path:
                self.times.add(name)
            elif predicate.startswith(self._types):
                self.paths[name] = nodes[name] = (*path, predicate)
            else:
                self._is_known = False


def _is(pattern: Pattern, predicate: str) -> bool:
    return pattern.predicates == frozenset({predicate}) and not (pattern.repeated or pattern.empty)


def _changed(call: Call, query: Query, found: _Message, added: dict[tuple[str, str], str]) -> str | None:
    """Return the aggregate over summaries ("": as it is), or None if there is none."""
    argument = strip_brackets(call.arguments[0]) if call.arguments else None
    names = frozenset[str]() if argument is None else variables_in(argument)
    if names is None:
        return None
    is_distinct = (
        "DISTINCT" in query.text[call.name_end : call.arguments[0].start if call.arguments else call.end].upper()
    )
    if names.isdisjoint(found.inner) and (is_distinct or call.name in ("MIN", "MAX", "SAMPLE")) and names:
        return ""  # of what does not differ between messages
    if is_distinct and call.name not in ("MIN", "MAX"):
        return None
    if argument is None:
        return f"SUM({_COUNT})"
    if not isinstance(argument, Reference) or (name := argument.name[1:]) not in found.bound:
        return None
    if call.name == "COUNT":
        return f"SUM({_COUNT})"
    if call.name not in _STATISTICS or name not in found.ends:
        return None
    predicate = _STATISTICS[call.name]
    if name in found.times and predicate == TOTAL:
        return None
    value = added.setdefault((name, predicate), f"?{_PREFIX}{len(added)}")
    if call.name == "AVG":
        return f"IF(SUM({_COUNT}) = 0, 0, SUM({value}) / SUM({_COUNT}))"
    return f"{'SUM' if predicate == TOTAL else 'MIN' if predicate == MINIMUM else 'MAX'}({value})"


def _covers(query: Query, inner: frozenset[str], edits: Iterable[tuple[int, int, str]]) -> bool:
    """Whether variables of messages occur only in WHERE and in what is edited."""
    first, last = query.braces
    outside = [(start, end) for start, end, _ in edits if not first < start < last]
    return all(
        first < token.start < last or any(start <= token.start < end for start, end in outside)
        for token in query.tokens
        if token.kind is Kind.VARIABLE and token.text[1:] in inner
    )


def _bound(test: Operand, times: set[str]) -> Interval | None:
    """Return exactly the times for which a test holds, None if that is not known."""
    test = strip_brackets(test)
    if not isinstance(test, Expression):
        return None
    found = ANY_TIME
    for parts in split_parts(test.parts, "&&"):
        if len(parts) == 1 and isinstance(parts[0], Expression):
            bound = _bound(parts[0], times)
        else:
            bound = _compared(parts, times)
        if bound is None:
            return None
        found = found.meet(bound)
    return found


def _comparison(parts: Sequence[Part]) -> tuple[Reference, str, Constant] | None:
    """Return the variable, the operator and the constant of a comparison."""
    if len(parts) != 3 or parts[1] not in _TURNED or isinstance(parts[0], str) or isinstance(parts[2], str):
        return None
    one, operator, other = strip_brackets(parts[0]), str(parts[1]), strip_brackets(parts[2])
    if isinstance(one, Constant):
        one, operator, other = other, _TURNED[operator], one
    return (one, operator, other) if isinstance(one, Reference) and isinstance(other, Constant) else None


def _compared(parts: Sequence[Part], times: set[str]) -> Interval | None:
    found = _comparison(parts)
    if found is None or found[0].name[1:] not in times:
        return None
    _, operator, other = found
    if not isinstance(other.term, Value) or not _ZONE.search(other.term.literal.value.rstrip()):
        return None
    moment = date_time_interval(other.term)
    if moment is None or moment.low != moment.high:
        return None
    if operator.startswith(">"):
        return Interval(low=moment.low + (operator == ">"))
    return Interval(high=moment.high - (operator == "<"))
