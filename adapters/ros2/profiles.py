"""Which quality of service we take: to hear everyone without holding anyone back, and to be heard by everyone. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from fnmatch import fnmatchcase

from rosld.adapters.model import Endpoint, Qos

_LATCHED_DEPTH = 16
"""A latched topic's late look holds at least so many messages: those of several publishers share one history."""


def override_for(topic: str, overrides: Sequence[tuple[str, Qos]]) -> Qos:
    """What the user said of a topic: the first profile whose glob fits, an empty one where none does."""
    return next((qos for glob, qos in overrides if fnmatchcase(topic, glob)), Qos())


def reading_profile(publishers: Sequence[Endpoint], depth: int, override: Qos = Qos()) -> Qos:  # noqa: B008
    """The profile to read with: best effort, so that no reliable writer ever waits for us.

    Where all publishers are transient-local it is theirs, so that what they said before we came is heard.
    """
    known = [each.qos for each in publishers if each.qos is not None]
    profile = Qos("best_effort", "volatile", "keep_last", depth)
    if known and all(qos.durability == "transient_local" and qos.reliability == "reliable" for qos in known):
        profile = Qos("reliable", "transient_local", "keep_last", max(depth, _LATCHED_DEPTH))
    return apply_override(profile, override)


def publishing_profile(subscribers: Sequence[Endpoint], *, latch: bool, override: Qos = Qos()) -> Qos:  # noqa: B008
    """The profile that all subscribers accept, and that keeps the last message for later ones where `latch`.

    DDS 1.4, 2.2.3: whoever offers more than is requested fits. So it is reliable, and whatever else was requested.
    """
    known = [each.qos for each in subscribers if each.qos is not None]
    keeps = latch or any(qos.durability == "transient_local" for qos in known)
    profile = Qos(
        "reliable",
        "transient_local" if keeps else "volatile",
        "keep_last",
        1 if latch else 10,
        deadline_ns=_least(qos.deadline_ns for qos in known),
        liveliness="manual_by_topic" if any(qos.liveliness == "manual_by_topic" for qos in known) else "automatic",
        lease_ns=_least(qos.lease_ns for qos in known),
    )
    return apply_override(profile, override)


def apply_override(profile: Qos, override: Qos) -> Qos:
    """The profile, but for what the override says."""
    said = {each.name: value for each in fields(Qos) if (value := getattr(override, each.name)) not in (None, 0)}
    return replace(profile, **said)


def is_compatible(reader: Qos, writer: Qos) -> bool:
    """Whether a reader of ours matches a writer of ours."""
    if reader.reliability == "reliable" and writer.reliability != "reliable":
        return False
    return not (reader.durability == "transient_local" and writer.durability != "transient_local")


def _least(times: Iterable[int | None]) -> int | None:
    return min((each for each in times if each is not None), default=None)
