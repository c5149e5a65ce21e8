"""Query parameters of requests for changes: rate, known state and timeout. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.server.http.fields import parse_decimal
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem

EVENT_STREAM = "text/event-stream"
DEFAULT_RATE, MIN_RATE, MAX_RATE = 50.0, 0.001, 1000.0
MOTION_RATE = 10.0
DEFAULT_TIMEOUT, MAX_TIMEOUT = 25.0, 60.0


def stream_is_preferred(accept: str | None, offers: tuple[str, ...]) -> bool:
    """Whether a request names event streams and prefers them to all other offers."""
    if accept is None or "event-stream" not in accept.lower():
        return False
    return choose_offer(accept, (*offers, EVENT_STREAM)) == EVENT_STREAM


def parse_rate(query: Mapping[str, str], default: float = DEFAULT_RATE) -> float:
    """Return `?rate=`, the maximum events per second, within limits. Raises a 400 Problem."""
    wanted = _number(query, "rate", default)
    if wanted is None or wanted < MIN_RATE:
        raise Problem(
            400,
            f"?rate={query['rate'][:100]} is not a number of events per second: send a number from {MIN_RATE:g} "
            f"to {MAX_RATE:g}.",
        )
    return min(wanted, MAX_RATE)


def parse_timeout(query: Mapping[str, str]) -> float:
    """Return `?timeout=`, the maximum seconds to wait. Raises a 400 Problem."""
    wanted = _number(query, "timeout", DEFAULT_TIMEOUT)
    if wanted is None:
        raise Problem(
            400,
            f"?timeout={query['timeout'][:100]} is not a number of seconds: send a number from 0 to {MAX_TIMEOUT:g}.",
        )
    return min(wanted, MAX_TIMEOUT)


def require_numbers(query: Mapping[str, str]) -> None:
    """Raise a 400 Problem for an invalid `?timeout=` or `?rate=`, even if it is not used."""
    parse_timeout(query)
    parse_rate(query)


def is_state(text: str | None, state: str) -> bool:
    """Whether a text names a state: as an event's id, or as the entity tag of any variant, quoted or not."""
    if text is None:
        return False
    given = text.strip().removeprefix("W/").strip('"')
    return given == state or given.rpartition(".")[0] == state


def _number(query: Mapping[str, str], name: str, default: float) -> float | None:
    given = query.get(name)
    if given is None:
        return default
    return parse_decimal(given)
