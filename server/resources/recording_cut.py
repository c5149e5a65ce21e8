"""Orders to cut recordings: `{"of": "run", "from": 60, "to": 90}` makes a recording of a part of another one."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple, TypeAlias

from rosld.adapters.base import FOR_EVER, Recording
from rosld.adapters.model.moment import Moment, parse_moment
from rosld.ontology.literals import date_time_nanoseconds
from rosld.server.auth.permissions import Permissions
from rosld.server.history.cut import CutRefused, Span, spans_around
from rosld.server.history.recording_orders import RecordingOrder
from rosld.server.http.problem import Problem
from rosld.server.resources.number_conditions import ConditionReader, parse_condition
from rosld.server.resources.recording_order import order_of, read_seconds
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.query_service import QueryService

_MARGIN = 5.0
_QUERY = re.compile(r"\bSELECT\b", re.IGNORECASE)
_MAX_READ = 1_000_000
"""Maximum number of messages of a topic that are read to find where a condition becomes true."""
_MAX_ROWS = 10_000
"""Maximum number of results of a query."""
Ask: TypeAlias = Callable[[str], Awaitable[Sequence[Sequence["str | None"]]]]
"""Function that returns the columns of the results of a query."""
_MEMBERS = frozenset({"of", "name", "topics", "from", "to", "around", "before", "after"})


class CutOrder(NamedTuple):
    """Order of cuts of the recording `of`, from `begin` to `end` or around events.

    `selection` has the name, the topics, and the seconds before an event.
    """

    of: str
    selection: RecordingOrder
    begin: Moment | None
    end: Moment | None
    around: Sequence[str]
    after: float


def cut_order_of(members: Mapping[str, object]) -> CutOrder:
    """Return the order with these members. Raises a 422 Problem that names the invalid member."""
    unknown = sorted(members.keys() - _MEMBERS)
    if unknown:
        raise Problem(422, f"{', '.join(unknown)[:200]} is unknown for a cut: {', '.join(sorted(_MEMBERS))}.")
    of, around = members["of"], members.get("around", [])
    given = around if isinstance(around, list) else [around]
    events = [each for each in given if isinstance(each, str)]
    if not isinstance(of, str) or len(events) < len(given):
        raise Problem(422, "of must be the name of a recording, and around a time, a condition or a query, or several.")
    selection = order_of(
        {
            "name": members.get("name"),
            "topics": members.get("topics", ["*"]),
            "before": members.get("before", _MARGIN),
        }
    )
    after = read_seconds(members, "after")
    begin, end = _moment(members, "from"), _moment(members, "to")
    return CutOrder(of, selection, begin, end, events, _MARGIN if after is None else after)


def _moment(members: Mapping[str, object], key: str) -> Moment | None:
    value = members.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise Problem(422, f"{key} is {str(value)[:100]!r}, neither a time nor a number of seconds.")
    try:
        return parse_moment(key, str(value))
    except ValueError as error:
        raise Problem(422, f"{error}.") from error


async def spans_of(order: CutOrder, recording: Recording, ask: Ask, may_read: Callable[[str], bool]) -> Sequence[Span]:
    """Return the spans to cut out; `may_read` says which topics a condition may be about.

    Raises CutRefused, RosError, Problems: 403, 422 and those of `ask`.
    """
    bounds = recording.start_ns, recording.end_ns
    first = bounds[0] if order.begin is None else order.begin.at(*bounds)
    last = FOR_EVER if order.end is None else order.end.at(*bounds)
    if first > last:
        raise CutRefused("from is after to")
    if not order.around:
        return [Span(first, last)]
    times: list[int] = []
    for each in order.around:
        with suppress(ValueError):
            times.append(parse_moment("around", each).at(*bounds))
            continue
        times += await (_times_of_query(each, ask) if _QUERY.search(each) else _times_of(each, recording, may_read))
    return spans_around([time for time in times if first <= time <= last], order.selection.before, order.after)


async def _times_of(text: str, recording: Recording, may_read: Callable[[str], bool]) -> Sequence[int]:
    """Return the times at which a condition becomes true. Raises RosError, and Problems: 403, 422."""
    try:
        condition = parse_condition(text)
        for topic in {each.topic for each in condition} & recording.topics.keys():
            if not may_read(topic):
                raise Problem(403, f"You may not read {topic}, so you may not cut around it.")
            if recording.topics[topic].count > _MAX_READ:
                raise Problem(422, f"{topic} has more than {_MAX_READ} messages: cut around the times of a query.")
        return await asyncio.to_thread(ConditionReader().times, recording, condition)
    except ValueError as error:
        raise Problem(422, f"around: {error}.") from error


async def _times_of_query(text: str, ask: Ask) -> Sequence[int]:
    """Return the first column of results with only xsd:dateTimes. Raises Problems."""
    columns = await ask(text)
    for column in columns:
        values = [each for each in column if each is not None]
        times = [time for each in values if (time := date_time_nanoseconds(each)) is not None]
        if times and len(times) == len(values):
            return times
    if any(columns):
        raise Problem(422, "around: no column of the query's results has only xsd:dateTimes.")
    return ()


def asking(queries: QueryService | None, permissions: Permissions) -> Ask:
    """Return a function that answers queries for an agent. It raises the problems of queries."""

    async def ask(text: str) -> Sequence[Sequence[str | None]]:
        if queries is None:
            raise Problem(422, "around: queries are not available here.")
        table = await queries.table(QueryRequest(text), _MAX_ROWS + 1, permissions=permissions)
        if len(table.rows) > _MAX_ROWS:
            raise Problem(422, f"around: the query has more than {_MAX_ROWS} results.")
        texts = ((None if each is None else getattr(each, "value", "") for each in row) for row in table.rows)
        return [list(column) for column in zip(*texts, strict=True)]

    return ask
