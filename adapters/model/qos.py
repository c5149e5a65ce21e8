"""Quality of service of publishers and subscribers (ROS 2): its text form, and incompatibilities. No I/O."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosld.adapters.model.graph import Endpoint

_DURABILITY = ("volatile", "transient_local")
_RELIABILITY = ("best_effort", "reliable")
_LIVELINESS = ("automatic", "manual_by_topic")
_WORDS = {
    "reliability": _RELIABILITY,
    "durability": _DURABILITY,
    "history": ("keep_last", "keep_all"),
    "liveliness": _LIVELINESS,
}
_TIMES = ("deadline", "lifespan", "lease")
_DEEPEST = 100_000
_LONGEST = 1e9


@dataclass(frozen=True, slots=True)
class Qos:
    """A profile, in the terms of rmw; None (and a `depth` of 0) is unknown.

    Times are in nanoseconds; a deadline, lifespan or lease of None is infinite.
    """

    reliability: str | None = None
    durability: str | None = None
    history: str | None = None
    depth: int = 0
    deadline_ns: int | None = None
    lifespan_ns: int | None = None
    liveliness: str | None = None
    lease_ns: int | None = None


def read_profile(text: str) -> Qos:
    """Return the profile in a text such as `best_effort,volatile,depth:5,deadline:0.1`; times are in seconds.

    Every policy may be omitted and must not be repeated. Raises ValueError naming the invalid word.
    """
    policies: dict[str, str | int] = {}
    for word in text.split(","):
        policy, value = _policy(word.strip())
        if policy in policies:
            raise ValueError(f"{word.strip()!r} sets the {policy.removesuffix('_ns')} twice")
        policies[policy] = value
    return replace(Qos(), **policies)  # type: ignore[arg-type]


def _policy(word: str) -> tuple[str, str | int]:
    name, colon, number = word.partition(":")
    if not colon:
        policy = next((policy for policy, words in _WORDS.items() if word in words), None)
        if policy is not None:
            return policy, word
    elif name == "depth":
        if number.isascii() and number.isdigit() and len(number) < 9 and 1 <= int(number) <= _DEEPEST:
            return name, int(number)
        raise ValueError(f"{word!r}: the depth must be an integer from 1 to {_DEEPEST}")
    elif name in _TIMES:
        nanoseconds = _nanoseconds(number)
        if nanoseconds is not None:
            return f"{name}_ns", nanoseconds
        raise ValueError(f"{word!r}: a {name} is a number of seconds from 0.000000001 to {_LONGEST:.0e}")
    words = ", ".join(each for words in _WORDS.values() for each in words)
    raise ValueError(
        f"{word!r} is not a policy; choose from {words}, depth:N, {', '.join(f'{each}:S' for each in _TIMES)}"
    )


def _nanoseconds(text: str) -> int | None:
    try:
        seconds = float(text) if text.isascii() and "_" not in text else 0.0
    except ValueError:
        return None
    return round(seconds * 1e9) if 1e-9 <= seconds <= _LONGEST else None


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A subscriber that cannot receive from a publisher: `policy` is the first incompatible one, with both values."""

    publisher: str
    subscriber: str
    policy: str
    offered: str
    requested: str


def mismatches(
    publishers: Sequence[Endpoint], subscribers: Sequence[Endpoint], limit: int | None = None
) -> tuple[Mismatch, ...]:
    """Return the incompatible pairs of one topic, each once and at most `limit`.

    DDS 1.4, 2.2.3: the requested quality must not exceed the offered one. Endpoints of one node with the same
    incompatibility count as one.
    """
    candidates = (
        Mismatch(publisher, subscriber, *words)
        for offering, requesting, words in _unfit_profiles(publishers, subscribers)
        for publisher in dict.fromkeys(offering)
        for subscriber in dict.fromkeys(requesting)
    )
    return tuple(islice(_distinct(candidates), limit))


def mismatch_count(publishers: Sequence[Endpoint], subscribers: Sequence[Endpoint]) -> int:
    """Return the number of incompatible pairs of endpoints of a topic."""
    pairs = _unfit_profiles(publishers, subscribers)
    return sum(len(offering) * len(requesting) for offering, requesting, _ in pairs)


def _unfit_profiles(
    publishers: Sequence[Endpoint], subscribers: Sequence[Endpoint]
) -> Iterator[tuple[Sequence[str], Sequence[str], tuple[str, str, str]]]:
    """Yield the nodes of publishers and subscribers with incompatible profiles, and the first incompatible policy.

    Each pair of profiles is compared once: the many endpoints of a topic like /rosout have few profiles.
    """
    requested = _by_profile(subscribers)
    for offer, offering in _by_profile(publishers).items():
        for request, requesting in requested.items():
            if (words := next(_unfit(offer, request), None)) is not None:
                yield offering, requesting, words


def _by_profile(endpoints: Sequence[Endpoint]) -> Mapping[Qos, Sequence[str]]:
    """Return the nodes of endpoints by the part of their profiles that can be incompatible."""
    nodes: dict[Qos, list[str]] = {}
    for endpoint in endpoints:
        if endpoint.qos is not None:
            profile = replace(endpoint.qos, history=None, depth=0, lifespan_ns=None)
            nodes.setdefault(profile, []).append(endpoint.node)
    return nodes


def _distinct(values: Iterable[Mismatch]) -> Iterator[Mismatch]:
    yielded: set[Mismatch] = set()
    for mismatch in values:
        if mismatch not in yielded:
            yielded.add(mismatch)
            yield mismatch


def _unfit(offered: Qos, requested: Qos) -> Iterator[tuple[str, str, str]]:
    for policy, ladder in (("reliability", _RELIABILITY), ("durability", _DURABILITY), ("liveliness", _LIVELINESS)):
        offer, request = getattr(offered, policy), getattr(requested, policy)
        if offer in ladder and request in ladder and ladder.index(offer) < ladder.index(request):
            yield policy, offer, request
    for policy in ("deadline", "lease"):
        offer, request = getattr(offered, f"{policy}_ns"), getattr(requested, f"{policy}_ns")
        if request is not None and (offer is None or offer > request):
            yield ("liveliness lease" if policy == "lease" else policy), _seconds_text(offer), _seconds_text(request)


def _seconds_text(nanoseconds: int | None) -> str:
    return "for ever" if nanoseconds is None else f"{nanoseconds / 1e9:g} s"
