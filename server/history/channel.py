"""Channels: one publisher's messages on one topic, and their records in MCAP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.model.mcap import OPENING, Fields
from rosld.server.history import mcap_records as mcap

_LATCHED = """- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""
"""QoS profile of a latched publisher, as rosbag2 writes it."""
_SYNTAXES = {Encoding.ROS1: "ros1msg", Encoding.CDR: "ros2msg"}
PROFILES = {Encoding.ROS1: "ros1", Encoding.CDR: "ros2"}


class Channel(NamedTuple):
    """One publisher's messages on one topic; `publisher` is empty if it is unknown.

    `is_opening`: latched messages from before the start of the file, which are written first.
    """

    topic: str
    type: TypeRef
    encoding: Encoding
    publisher: str
    latched: bool
    is_opening: bool = False


def channel_of(topic: str, sample: Sample, *, is_opening: bool = False) -> Channel:
    """Return the channel of a sample of a topic."""
    return Channel(topic, sample.schema, sample.encoding, sample.publisher, sample.latched, is_opening)


def channel_record(number: int, schema: int, channel: Channel) -> bytes:
    """Return the MCAP record of a channel, with the metadata that rosbag and rosbag2 write."""
    return mcap.channel(number, schema, channel.topic, channel.encoding.value, _metadata(channel))


def schema_record(number: int, type: TypeRef, encoding: Encoding, definition: str) -> bytes:
    """Return the MCAP record of a message type."""
    name = type.name.replace("/msg/", "/") if encoding is Encoding.ROS1 else type.name
    return mcap.schema(number, name, _SYNTAXES[encoding], definition)


def read_channel(fields: Fields, types: Mapping[int, str]) -> tuple[int, Channel]:
    """Return a channel and its number; `types` maps schema numbers to names. Raises ValueError, KeyError."""
    number, schema = fields.uint(2), fields.uint(2)
    topic, encoding, metadata = fields.text(), Encoding(fields.text()), fields.texts()
    is_latched = metadata.get("latching") == "1" or "transient_local" in metadata.get("offered_qos_profiles", "")
    hash = metadata.get("md5sum") or metadata.get("topic_type_hash") or None
    type, is_opening = TypeRef(types[schema], hash), metadata.get(OPENING) == "1"
    return number, Channel(topic, type, encoding, metadata.get("callerid", ""), is_latched, is_opening)


def model_name(recorded: str) -> str:
    """Return the model's name of a recorded type: ROS 1 records `pkg/Name`."""
    package, _, name = recorded.partition("/")
    return recorded if "/" in name else f"{package}/msg/{name}"


def _metadata(channel: Channel) -> Mapping[str, str]:
    metadata = {"callerid": channel.publisher} if channel.publisher else {}
    metadata |= {OPENING: "1"} if channel.is_opening else {}
    if channel.encoding is Encoding.ROS1:
        metadata |= {"topic": channel.topic, "latching": "1" if channel.latched else "0"}
        return metadata | ({"md5sum": channel.type.hash} if channel.type.hash else {})
    metadata["offered_qos_profiles"] = _LATCHED if channel.latched else ""
    return metadata | ({"topic_type_hash": channel.type.hash} if channel.type.hash else {})
