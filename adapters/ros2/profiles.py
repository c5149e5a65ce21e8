"""Quality of service: conversion from and to rclpy's profiles, and profiles that match all endpoints. No I/O."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from fnmatch import fnmatchcase
from typing import Any

from rosld.adapters.model import Endpoint, Qos

_LATCHED_DEPTH = 16
"""Minimum history depth for a latched topic, because several publishers share the history."""


def override_for(topic: str, overrides: Sequence[tuple[str, Qos]]) -> Qos:
    """Return the user's profile for a topic: the first whose glob matches, or an empty one."""
    return next((qos for glob, qos in overrides if fnmatchcase(topic, glob)), Qos())


def reading_profile(publishers: Sequence[Endpoint], depth: int, override: Qos = Qos()) -> Qos:  # noqa: B008
    """Return the profile for reading: best effort, so that no reliable writer ever waits for us.

    If all publishers are transient local and reliable, so is the profile, to receive their earlier messages.
    """
    profiles = [each.qos for each in publishers if each.qos is not None]
    profile = Qos("best_effort", "volatile", "keep_last", depth)
    if profiles and all(qos.durability == "transient_local" and qos.reliability == "reliable" for qos in profiles):
        profile = Qos("reliable", "transient_local", "keep_last", max(depth, _LATCHED_DEPTH))
    return apply_override(profile, override)


def publishing_profile(subscribers: Sequence[Endpoint], *, latch: bool, override: Qos = Qos()) -> Qos:  # noqa: B008
    """Return a profile that all subscribers accept; with `latch`, later subscribers receive the last message.

    DDS 1.4, 2.2.3: the offer must be at least what is requested, so it is reliable, with the strictest values.
    """
    profiles = [each.qos for each in subscribers if each.qos is not None]
    keeps = latch or any(qos.durability == "transient_local" for qos in profiles)
    profile = Qos(
        "reliable",
        "transient_local" if keeps else "volatile",
        "keep_last",
        1 if latch else 10,
        deadline_ns=_least(qos.deadline_ns for qos in profiles),
        liveliness="manual_by_topic" if any(qos.liveliness == "manual_by_topic" for qos in profiles) else "automatic",
        lease_ns=_least(qos.lease_ns for qos in profiles),
    )
    return apply_override(profile, override)


def apply_override(profile: Qos, override: Qos) -> Qos:
    """Return the profile with the values of the override."""
    policies = {each.name: value for each in fields(Qos) if (value := getattr(override, each.name)) not in (None, 0)}
    return replace(profile, **policies)


def is_compatible(reader: Qos, writer: Qos) -> bool:
    """Whether a reader of ours matches a writer of ours."""
    if reader.reliability == "reliable" and writer.reliability != "reliable":
        return False
    return not (reader.durability == "transient_local" and writer.durability != "transient_local")


def _least(times: Iterable[int | None]) -> int | None:
    return min((each for each in times if each is not None), default=None)


_FOR_EVER = 2**63 - 1
_POLICIES = {
    "reliability": {"RELIABLE": "reliable", "BEST_EFFORT": "best_effort"},
    "durability": {"TRANSIENT_LOCAL": "transient_local", "VOLATILE": "volatile"},
    "history": {"KEEP_LAST": "keep_last", "KEEP_ALL": "keep_all"},
    "liveliness": {"AUTOMATIC": "automatic", "MANUAL_BY_TOPIC": "manual_by_topic"},
}


def qos_of_profile(profile: Any) -> Qos:
    """Return the Qos for rclpy's profile of an endpoint; None for defaults and unknown policies."""
    words = {policy: table.get(getattr(profile, policy).name) for policy, table in _POLICIES.items()}
    return Qos(
        **words,
        depth=profile.depth if words["history"] == "keep_last" else 0,
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def _nanoseconds(duration: Any) -> int | None:
    """Return a time; None if it is infinite or unspecified (zero)."""
    nanoseconds = int(duration.nanoseconds)
    return nanoseconds if 0 < nanoseconds < _FOR_EVER // 2 else None


def profile_of_qos(qos: Qos) -> Any:
    """Return rclpy's profile; the defaults are reliable, volatile, and a history of one."""
    module = importlib.import_module("rclpy.qos")
    duration = importlib.import_module("rclpy.duration").Duration
    policies: dict[str, object] = {
        "history": module.HistoryPolicy[(qos.history or "keep_last").upper()],
        "depth": max(qos.depth, 1),
        "reliability": module.ReliabilityPolicy[(qos.reliability or "reliable").upper()],
        "durability": module.DurabilityPolicy[(qos.durability or "volatile").upper()],
        "liveliness": module.LivelinessPolicy[(qos.liveliness or "automatic").upper()],
    }
    for name, value in (
        ("deadline", qos.deadline_ns),
        ("lifespan", qos.lifespan_ns),
        ("liveliness_lease_duration", qos.lease_ns),
    ):
        if value is not None:
            policies[name] = duration(nanoseconds=value)
    return module.QoSProfile(**policies)
