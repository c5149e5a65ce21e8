"""Key expressions and attachments of rmw_zenoh, as its design document describes them. No I/O.

Every entity of ROS 2 holds a liveliness token, whose key says all about it:
`@ros2_lv/DOMAIN/SESSION/NODE/ID/KIND/ENCLAVE/NAMESPACE/NAME` of a node, and for others also `/TOPIC/TYPE/HASH/QOS`.
Messages and calls have the key `DOMAIN/TOPIC/TYPE/HASH`.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from rosld.adapters.model import Qos, TypeRef

NODE, PUBLISHER, SUBSCRIBER, SERVER, CLIENT = "NN", "MP", "MS", "SS", "SC"
SPACE = "@ros2_lv"
_OF_NODE, _OF_ENDPOINT = 9, 13
_DDS = "::dds_::"
_RELIABILITY = {"1": "reliable", "2": "best_effort"}
_DURABILITY = {"1": "transient_local", "2": "volatile"}
_HISTORY = {"1": "keep_last", "2": "keep_all"}
_LIVELINESS = {"1": "automatic", "3": "manual_by_topic"}
_DEPTH = 42
"""Depth of the default profile, whose values keys omit: reliable, volatile, the last 42, and no limits of time."""
_ATTACHMENT = struct.Struct("<qqB16s")


class Token(NamedTuple):
    """An entity: its kind, its node, and for endpoints the topic or service, its type and profile."""

    kind: str
    node: str
    topic: str
    type: TypeRef
    qos: Qos


class Attachment(NamedTuple):
    """Attachment of a message or a call: its number, its time in ns, and the id of its sender."""

    number: int
    source_ns: int
    gid: bytes


def parse_token(key: str) -> Token | None:
    """Return the entity of a token, or None for another key."""
    parts = key.split("/")
    if len(parts) < _OF_NODE or parts[0] != SPACE:
        return None
    kind, (_, namespace, name) = parts[5], map(_unmangled, parts[6:9])
    node = f"{namespace.rstrip('/')}/{name}"
    if kind == NODE:
        return Token(kind, node, "", TypeRef(""), Qos())
    if len(parts) != _OF_ENDPOINT:
        return None
    topic, type, hash = map(_unmangled, parts[9:12])
    return Token(
        kind, node, topic, TypeRef(ros_type(type), hash if hash.startswith("RIHS") else None), qos_of(parts[12])
    )


def token_key(token: Token, domain: int, session: str, node_id: int, id: int) -> str:
    """Return the key of the token of an entity of ours."""
    namespace, _, name = token.node.rpartition("/")
    parts = [SPACE, str(domain), session, str(node_id), str(id), token.kind, "%", _mangled(namespace or "/"), name]
    if token.kind != NODE:
        parts += [_mangled(token.topic), dds_type(token.type.name), token.type.hash or "", qos_key(token.qos)]
    return "/".join(parts)


def data_key(domain: int, topic: str, type: str, hash: str = "*") -> str:
    """Return the key of the messages of a topic, or of the calls of a service."""
    return f"{domain}/{topic.strip('/')}/{dds_type(type)}/{hash}"


def dds_type(name: str) -> str:
    """Return `std_msgs::msg::dds_::String_` for `std_msgs/msg/String`."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}{_DDS}{short}_"


def ros_type(name: str) -> str:
    """Return `std_msgs/msg/String` for `std_msgs::msg::dds_::String_`."""
    return name.replace(_DDS, "::").replace("::", "/").removesuffix("_")


def qos_of(key: str) -> Qos:
    """Return the profile in a token; policies that cannot be read are unknown."""
    reliability, durability, history, deadline, lifespan, liveliness = (*key.split(":"), *[""] * 6)[:6]
    kept, depth = (*history.split(","), "", "")[:2]
    kind, *lease = (*liveliness.split(","), "", "", "")[:3]
    return Qos(
        _RELIABILITY.get(reliability or "1"),
        _DURABILITY.get(durability or "2"),
        _HISTORY.get(kept or "1"),
        int(depth) if depth.isdigit() else _DEPTH,
        _nanoseconds(deadline.split(",")),
        _nanoseconds(lifespan.split(",")),
        _LIVELINESS.get(kind or "1"),
        _nanoseconds(lease),
    )


def qos_key(qos: Qos) -> str:
    """Return a profile as tokens have it."""
    reliability = "2" if qos.reliability == "best_effort" else ""
    durability = "1" if qos.durability == "transient_local" else ""
    history = "2," if qos.history == "keep_all" else f",{qos.depth}" if qos.depth not in (0, _DEPTH) else ","
    liveliness = "3" if qos.liveliness == "manual_by_topic" else ""
    times = [_time_key(each) for each in (qos.deadline_ns, qos.lifespan_ns, qos.lease_ns)]
    return f"{reliability}:{durability}:{history}:{times[0]}:{times[1]}:{liveliness},{times[2]}"


def _nanoseconds(parts: list[str]) -> int | None:
    seconds, nanoseconds = (*parts, "", "")[:2]
    if not (seconds.isdigit() or nanoseconds.isdigit()):
        return None  # infinite
    return int(seconds or 0) * 10**9 + int(nanoseconds or 0)


def _time_key(nanoseconds: int | None) -> str:
    return "," if nanoseconds is None else "{},{}".format(*divmod(nanoseconds, 10**9))


def write_attachment(attachment: Attachment) -> bytes:
    """Return the bytes of an attachment; the id has its length before it."""
    return _ATTACHMENT.pack(attachment.number, attachment.source_ns, len(attachment.gid), attachment.gid)


def read_attachment(data: bytes) -> Attachment | None:
    """Return an attachment, or None for other bytes."""
    if len(data) != _ATTACHMENT.size:
        return None
    number, source_ns, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(number, source_ns, gid)


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _unmangled(name: str) -> str:
    return name.replace("%", "/")
