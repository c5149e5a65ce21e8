"""Limits of queries, and the problems of queries that exceed them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from itertools import islice
from typing import NamedTuple

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.vocab import ros, xsd
from rosld.server.http.problem import Problem

_MIB = 1024 * 1024
MAX_PAST = 250_000
"""Maximum number of recorded messages per query: more than an hour at 50 Hz."""
_RETRY_AFTER = {"Retry-After": "1"}
_MAX_NAMED = 5
"""Maximum number of documents that a problem lists."""


class Limits(NamedTuple):
    """Limits of queries.

    `seconds` for a complete answer, `memory` in bytes beyond the dataset, `rows` of an answer (triples of a graph);
    `concurrency` queries run at a time, and `queue` more may wait.
    """

    seconds: float = 10.0
    memory: int = 1024 * _MIB
    rows: int = 1_000_000
    concurrency: int = 4
    queue: int = 256


DEFAULT_LIMITS = Limits()


def describe_limits(service: NamedNode, limits: Limits) -> tuple[Triple, ...]:
    """Return the limits as triples for the service description."""
    return (
        Triple(service, ros.timeLimit, Literal(str(limits.seconds), datatype=xsd.double)),
        *(
            Triple(service, predicate, Literal(str(number), datatype=xsd.integer))
            for predicate, number in (
                (ros.memoryLimit, limits.memory),
                (ros.rowLimit, limits.rows),
                (ros.pastLimit, MAX_PAST),
                (ros.concurrencyLimit, limits.concurrency),
                (ros.queueLimit, limits.queue),
            )
        ),
    )


class StopReason(Enum):
    """Reason for stopping a query: the member `reason` of its problem details."""

    TIME = "time"
    MEMORY = "memory"
    ROWS = "rows"
    PAST = "past"


def out_of_time(seconds: float, counts: Mapping[str, int] = {}) -> Problem:
    """Return the problem of a query that exceeded its time limit; `counts` are its recorded messages by topic."""
    words = f"The query exceeded its time limit of {seconds:g} s"
    if not counts:
        return _stop_problem(StopReason.TIME, f"{words}: ask for less at a time.")
    largest = sorted(counts.items(), key=lambda each: -each[1])[:_MAX_NAMED]
    listed = ", ".join(f"{count} of {topic}" for topic, count in largest)
    return _stop_problem(
        StopReason.TIME,
        f"{words} over recorded messages ({listed}). Bound the ros:received of each, and join topics by "
        "BIND(ros:asOf(?topic, ?time) AS ?message) or ros:previous instead of comparing all times with all.",
    )


def out_of_memory(memory: int) -> Problem:
    """Return the problem of a query that exceeded its memory limit."""
    mebibytes = memory // _MIB
    return _stop_problem(
        StopReason.MEMORY, f"The query exceeded this server's memory limit of {mebibytes} MiB: ask for less."
    )


def too_many_rows(rows: int) -> Problem:
    """Return the problem of an answer that exceeds the row limit."""
    return _stop_problem(StopReason.ROWS, f"The result exceeds this server's limit of {rows} rows: use LIMIT.")


def too_much_past(words: str) -> Problem:
    """Return the problem of a query that would have to read too many recorded messages."""
    return _stop_problem(
        StopReason.PAST,
        f"{words} Ask for less: name in the group of each ros:past a topic (or its ros:name, or a field of "
        'one message type) and a time, as in FILTER(?received > NOW() - "PT60S"^^xsd:dayTimeDuration), or a '
        'recording, as in ?bag ros:name "NAME"; or for aggregates of numbers (MIN, MAX, SUM, AVG, COUNT), which are '
        "answered from statistics. A message pattern without ros:past matches all messages.",
    )


def too_many_queries() -> Problem:
    """Return the problem of a query that finds all workers busy and the queue full."""
    return Problem(
        503,
        "All query workers are busy and the queue is full; try again in a moment.",
        headers=_RETRY_AFTER,
        extra={"reason": "busy"},
    )


def incomplete(unread: Mapping[str, str]) -> Problem:
    """Return the problem of a query that can match values which could not be read; the reasons are by URL."""
    first = [f"<{url}>: {reason.rstrip('.')}" for url, reason in islice(sorted(unread.items()), _MAX_NAMED)]
    more = f", and {len(unread) - len(first)} more" if len(unread) > len(first) else ""
    words = (
        f"The result would be incomplete: {'; '.join(first)}{more}. Name the documents of the query with "
        "GRAPH, subscribe with --subscribe, raise the limit, or accept partial results with ?partial=true."
    )
    return Problem(503, words, headers=_RETRY_AFTER, extra={"reason": "incomplete"}, about=tuple(sorted(unread)))


def process_crashed(how: str) -> Problem:
    """Return the problem of a query whose process crashed."""
    return Problem(500, f"The process of the query died before it finished ({how}); the server keeps running.")


def process_restarting(seconds: int, progress: str = "") -> Problem:
    """Return the problem of a query while its process restarts; `progress` is a sentence on the state of loading."""
    words = "The query process is starting: try again in a moment."
    if progress:
        words = f"{progress} Try again then."
    return Problem(503, words, headers={"Retry-After": str(seconds)}, extra={"reason": "starting"})


def dataset_behind() -> Problem:
    """Return the problem of a query that must see a change still being loaded."""
    words = "A large change that the query must see is being loaded into the dataset: try again in a moment."
    return Problem(503, words, headers=_RETRY_AFTER, extra={"reason": "starting"})


def _stop_problem(reason: StopReason, detail: str) -> Problem:
    return Problem(503, detail, extra={"reason": reason.value})
