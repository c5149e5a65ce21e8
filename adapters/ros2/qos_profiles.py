"""Quality of service as rclpy has it and as the graph tells it."""

from __future__ import annotations

import importlib
from typing import Any

from rosld.adapters.model import Qos

_FOR_EVER = 2**63 - 1
_POLICIES = {
    "reliability": {"RELIABLE": "reliable", "BEST_EFFORT": "best_effort"},
    "durability": {"TRANSIENT_LOCAL": "transient_local", "VOLATILE": "volatile"},
    "history": {"KEEP_LAST": "keep_last", "KEEP_ALL": "keep_all"},
    "liveliness": {"AUTOMATIC": "automatic", "MANUAL_BY_TOPIC": "manual_by_topic"},
}


def qos_of_profile(profile: Any) -> Qos:
    """What rclpy's profile says of an endpoint; None for policies that are the system's default or not known."""
    words = {policy: table.get(getattr(profile, policy).name) for policy, table in _POLICIES.items()}
    return Qos(
        **words,
        depth=profile.depth if words["history"] == "keep_last" else 0,
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def _nanoseconds(duration: Any) -> int | None:
    """A time, None for ever: which is "infinite" or, where nobody said anything, zero."""
    found = int(duration.nanoseconds)
    return found if 0 < found < _FOR_EVER // 2 else None


def profile_of_qos(qos: Qos) -> Any:
    """rclpy's profile; what is not said is best effort's opposite: reliable, volatile, the last one."""
    module = importlib.import_module("rclpy.qos")
    duration = importlib.import_module("rclpy.duration").Duration
    given: dict[str, object] = {
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
            given[name] = duration(nanoseconds=value)
    return module.QoSProfile(**given)
