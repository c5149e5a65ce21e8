"""Export of recordings for ROS tools: ROS 1 bags and folders of ROS 2 bags, written by rosbags."""

from __future__ import annotations

import asyncio
import shutil
import struct
import tarfile
from collections.abc import Iterator
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Literal, NamedTuple

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

from rosld.adapters.base import AdapterOptions, Recording
from rosld.adapters.model import Encoding, Sample, TypeRef, UnknownType
from rosld.adapters.model.schema import latched_depth
from rosld.server.history.history_writer import require_room
from rosld.server.history.uploads import opened_recording
from rosld.server.http.problem import Problem
from rosld.server.runtime.offload import WorkerPool
from rosld.server.settings import Settings

_OPEN_SECONDS = 600.0
_NO_TIME = QosTime(9223372036, 854775807)
_METADATA_VERSION: Literal[8] = 8
"""Version of `metadata.yaml`: the newest that ROS 2 releases before Jazzy can read."""
_DISCARDED = (0, 0)
_CHECKED = 1 << 20
"""Bytes of messages between checks of the free disk space."""


_EXPORT_SECONDS = 3600.0
"""Maximum seconds of one export: enough for a hundred gigabytes."""
_MAX_PENDING = 4


class CannotExport(ValueError):
    """Why a recording cannot be exported to a format: a sentence without its full stop."""


class ExportFormat(NamedTuple):
    """Export format for one version of ROS: its name in `?format=`, its media type, and its file suffix."""

    name: str
    encoding: Encoding
    media_type: str
    suffix: str
    about: str


BAG = ExportFormat("bag", Encoding.ROS1, "application/x-rosbag", ".bag", "a ROS 1 bag")
ROSBAG2 = ExportFormat("rosbag2", Encoding.CDR, "application/x-tar", ".tar", "a ROS 2 bag, a folder in a tar archive")
EXPORT_FORMATS = {each.name: each for each in (BAG, ROSBAG2)}


def require_encoding(name: str, encoding: Encoding, format: ExportFormat) -> None:
    """Raise CannotExport if the messages of a recording are of the other ROS, whose encoding differs."""
    if encoding is not format.encoding:
        own = next(each for each in EXPORT_FORMATS.values() if each.encoding is encoding)
        version = 1 if encoding is Encoding.ROS1 else 2
        raise CannotExport(
            f"the messages of {name} are of ROS {version}, which {format.about} cannot hold: ?format={own.name} "
            f"is {own.about}, and rosbags-convert (of the PyPI package rosbags) converts that to the other "
            "version of ROS"
        )


class BagExports:
    """Exports for clients, one at a time, in a process that is killed when its client has disconnected."""

    def __init__(self, settings: Settings) -> None:
        self._options = AdapterOptions(types=settings.types)
        self._workers = WorkerPool(1, _EXPORT_SECONDS, subject="recording")
        self._pending = 0

    async def make(self, recording: Recording, format: ExportFormat, target: Path) -> FileIO:
        """Convert a recording to a file at `target`, and return it open; closing it leaves nothing on the disk.

        Raises CannotExport, OSError, RosError, and Problem 503 if too many exports are waiting.
        """
        if self._pending >= _MAX_PENDING:
            words = "Too many recordings are being converted: try again later."
            raise Problem(503, words, headers={"Retry-After": "30"})
        self._pending += 1
        try:
            await self._workers.run(
                partial(export_archive, recording.path, target, format, recording.name, self._options)
            )
            return await asyncio.to_thread(FileIO, target)
        finally:
            self._pending -= 1
            await asyncio.to_thread(_remove, target)

    async def close(self) -> None:
        """Stop all exports. Idempotent."""
        await self._workers.close()


def _remove(target: Path) -> None:
    target.unlink(missing_ok=True)
    shutil.rmtree(_folder_of(target), ignore_errors=True)


def _folder_of(target: Path) -> Path:
    """Return the folder that is then packed into `target`."""
    return target.with_name(f"{target.name}.folder")


def export_archive(source: Path, target: Path, format: ExportFormat, name: str, options: AdapterOptions) -> None:
    """Write the recording at a path as a single file or archive, in which it has this name. Raises as `export`."""
    if format == BAG:
        export(source, target, format, options)
        return
    folder = _folder_of(target) / name
    export(source, folder, format, options)
    with tarfile.open(target, "w") as archive:
        archive.add(folder, name)


def export(source: Path, target: Path, format: ExportFormat, options: AdapterOptions) -> None:
    """Write the recording at a path as a bag: a file for ROS 1, a folder for ROS 2. Slow, but needs little memory.

    Raises CannotExport, OSError for the disk, and RosError if the recording cannot be read.
    """
    try:
        with opened_recording(source, options, _OPEN_SECONDS) as recording:
            require_encoding(recording.name, recording.encoding, format)
            (write_bag if format == BAG else write_rosbag2)(recording, target)
    except (rosbag1.WriterError, rosbag2.WriterError, UnicodeError, struct.error) as error:
        raise CannotExport(f"{source.name} cannot be written as {format.about}: {error}") from error


def write_bag(recording: Recording, target: Path) -> None:
    """Write a ROS 1 recording as a bag with one connection per publisher. Raises OSError."""
    connections: dict[tuple[object, ...], Connection] = {}
    with rosbag1.Writer(target) as writer:
        for topic, sample in _messages(recording, target.parent):
            key = topic, sample.schema, sample.publisher, sample.latched
            if key not in connections:
                connections[key] = writer.add_connection(
                    topic,
                    sample.schema.name,
                    msgdef=_definition(recording, sample.schema),
                    md5sum=sample.schema.hash or "*",
                    callerid=sample.publisher or None,
                    latching=int(sample.latched),
                )
            writer.write(connections[key], sample.received_ns, sample.data)
            _forget_places(writer)


def write_rosbag2(recording: Recording, target: Path) -> None:
    """Write a ROS 2 recording as the folder of a bag that contains MCAP. Raises CannotExport, OSError."""
    connections: dict[tuple[object, ...], Connection] = {}
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(target, version=_METADATA_VERSION, storage_plugin=plugin) as writer:
        for topic, sample in _messages(recording, target.parent):
            key = topic, sample.schema.name, sample.latched
            if key not in connections:
                connections[key] = writer.add_connection(
                    topic,
                    sample.schema.name,
                    msgdef=_definition(recording, sample.schema),
                    rihs01=_hash(recording, topic, sample.schema),
                    offered_qos_profiles=(_latched(sample.schema.name),) if sample.latched else (),
                )
            writer.write(connections[key], sample.received_ns, sample.data)


def _latched(type_name: str) -> Qos:
    """Return the QoS profile of a player's only publisher, which stores the messages of all recorded publishers."""
    return Qos(
        QosHistory.KEEP_LAST,
        latched_depth(type_name),
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        _NO_TIME,
        _NO_TIME,
        QosLiveliness.AUTOMATIC,
        _NO_TIME,
        avoid_ros_namespace_conventions=False,
    )


def _messages(recording: Recording, folder: Path) -> Iterator[tuple[str, Sample]]:
    """Yield all messages with their topics; raise OSError when the disk is full."""
    left = 0
    for message in recording.messages():
        if left <= 0:
            if folder.is_dir():
                require_room(folder)
            left = _CHECKED
        left -= len(message.sample.data)
        yield message.topic, message.sample


def _definition(recording: Recording, ref: TypeRef) -> str:
    """Return the text of a type, or an empty string if it is unknown: players do not read it."""
    try:
        return recording.schema(ref).definition
    except UnknownType:
        return ""


def _hash(recording: Recording, topic: str, ref: TypeRef) -> str:
    try:
        hash = ref.hash or recording.schema(ref).ref.hash
    except UnknownType:
        hash = None
    if not hash:
        raise CannotExport(f"the type {ref.name} of {topic} is not known: provide its definition with --types")
    return hash


def _forget_places(writer: rosbag1.Writer) -> None:
    """Replace the index entries of written messages, 120 bytes each: the writer needs only their count."""
    for chunk in reversed(writer.chunks[:-1]):
        if not chunk.connections or next(iter(chunk.connections.values()))[0] == _DISCARDED:
            return
        for number, places in chunk.connections.items():
            chunk.connections[number] = [_DISCARDED] * len(places)
