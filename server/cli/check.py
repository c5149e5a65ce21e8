"""`rosld check`: what would work and what not, on this machine and at the robot, which is only read."""

from __future__ import annotations

import asyncio
import os
import shutil
import ssl
import statistics
import struct
import time
from collections.abc import Iterable, Iterator
from datetime import datetime, timezone
from pathlib import Path

import click

from rosld.adapters.base import Adapter, AdapterOptions, Finding, NullSink
from rosld.adapters.model import Encoding, Graph, MessageSchema, RosError, Sample, Stale, Topic, TypeRef, UnknownType
from rosld.adapters.model.qos import mismatches
from rosld.adapters.registry import adapter_for, diagnosis_of, without_credentials
from rosld.server import settings as settings_module
from rosld.server.auth.config import read_config
from rosld.server.cli import data_folder
from rosld.server.cli.failure import ExitCode, code_of
from rosld.server.cli.list_types import OPEN_SECONDS, types_in_use
from rosld.server.cli.tables import duration_text, json_text, size_text
from rosld.server.serving.http_server import bind, require_certificate
from rosld.server.settings import Settings
from rosld.server.storage.files import FileLock

_TYPE_SECONDS, _STAMP_SECONDS = 5.0, 3.0
_SHOWN = 10
"""Maximum number of names in a finding, and of topics whose stamps are read."""
_STEP = 0.05
_COMPARED = 50
"""Maximum number of topics with several publishers whose types are compared."""
_APART = 1.0
"""Seconds between clocks from which on they are reported."""
_LITTLE = 100_000_000
_SOON = 30 * 24 * 3600
_HEADER = "std_msgs/msg/Header"
_LARGE = ("Image", "CompressedImage", "PointCloud", "PointCloud2", "OccupancyGrid")
_COLORS = {"ok": "green", "warning": "yellow", "error": "red"}


def check(source: str, settings: Settings, *, base_given: bool, as_json: bool) -> int:
    """Print findings; return the exit code: that of the first error as `rosld serve` would have it, else 0."""
    findings, code = robot_findings(source, settings.adapter_options)
    machine = [*machine_findings(settings, base_given=base_given)]
    if code == 0 and any(each.level == "error" for each in machine):
        code = ExitCode.FAILED
    findings = [*machine, *findings]
    if as_json:
        found = {"exitCode": int(code), "findings": [each._asdict() for each in findings]}
        click.echo(json_text({"source": without_credentials(source), **found}))
        return code
    width = max(len(each.subject) for each in findings)
    for each in findings:
        level = click.style(each.level.ljust(7), fg=_COLORS[each.level], bold=each.level == "error")
        click.echo(f"{level}  {each.subject.ljust(width)}  {each.text}")
        if each.step:
            click.echo(f"{' ' * (width + 11)}→ {each.step}")
    return code


# This machine


def machine_findings(settings: Settings, *, base_given: bool) -> Iterator[Finding]:
    """Yield what concerns the address, the data folder, the rules for access and the certificate of a server."""
    try:
        bind(settings.host, settings.port).close()
        yield Finding("ok", "address", f"{settings.host}:{settings.port} is free")
    except ValueError as error:
        yield Finding("error", "address", str(error))
    try:
        settings = settings_module.bound(settings, settings.port, base_given=base_given)
    except ValueError as error:
        yield Finding("error", "base URL", str(error))
    if settings.data is not None:
        yield from _folder_findings(settings.data, settings.base_url)
    if settings.auth is not None:
        try:
            read_config(settings.auth, settings.base_url)
            yield Finding("ok", "auth", f"{settings.auth} can be read")
        except ValueError as error:
            yield Finding("error", "auth", str(error), "rosld token add writes a valid file")
    elif settings.beyond_loopback:
        text = f"{settings.host} is reachable from other machines, so the server is read-only"
        yield Finding("warning", "auth", text, "use --auth to define who may write")
    if settings.tls_cert is not None:
        yield _certificate_finding(settings.tls_cert, settings.tls_key)


def _folder_findings(folder: Path, base: str) -> Iterator[Finding]:
    parent = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        step = "change its owner, or choose another folder with --data"
        yield Finding("error", "data", f"{parent} is not a folder that this user may write to", step)
        return
    if (free := shutil.disk_usage(parent).free) < _LITTLE:
        level = "warning" if free else "error"
        yield Finding(
            level, "data", f"the disk of {folder} has {size_text(free)} left", "make room, or use another disk"
        )
    try:
        found = data_folder.read_base(folder)
        lock = FileLock(folder / data_folder.LOCK) if (folder / data_folder.LOCK).exists() else None
    except OSError as error:
        yield Finding("error", "data", f"{folder}: {error.strerror or error}")
        return
    is_locked, holder = lock is not None and not lock.acquire(), lock and lock.read()
    if lock is not None:
        lock.close()
    if is_locked:
        step = "stop that one first, or choose another folder with --data"
        yield Finding("error", "data", f"{folder} is served by another rosld (process {holder or 'unknown'})", step)
    elif found is not None and found != base:
        yield Finding("error", "data", f"{folder} belongs to {found}, not {base}", f"start with --base-url {found}")
    elif free:
        yield Finding("ok", "data", f"{folder} can be written, {size_text(free)} are free")


def _certificate_finding(certificate: Path, key: Path | None) -> Finding:
    subject = "certificate"
    try:
        require_certificate(certificate, key)
        # The ssl module decodes a certificate only with this function, or after a handshake that verifies it.
        end = ssl.cert_time_to_seconds(ssl._ssl._test_decode_cert(str(certificate))["notAfter"])  # type: ignore[attr-defined]
    except (ValueError, OSError) as error:
        return Finding("error", subject, str(error))
    day = datetime.fromtimestamp(end, timezone.utc).date()
    if end < time.time():
        return Finding("error", subject, f"{certificate} expired on {day}", "renew it: clients refuse it")
    return Finding("warning" if end < time.time() + _SOON else "ok", subject, f"{certificate} is valid until {day}")


# The robot


def robot_findings(source: str, options: AdapterOptions) -> tuple[list[Finding], int]:
    """Return what concerns a source, and the exit code: 0 without an error."""
    graph: Graph | None = None
    try:
        adapter = adapter_for(source, options)
        findings, graph, code = asyncio.run(_looked(adapter))
    except ValueError as error:
        findings, code = [Finding("error", "source", str(error))], int(ExitCode.FAILED)
    diagnose = diagnosis_of(source)
    if diagnose is not None:
        findings += diagnose(source, options, graph)
        if code == 0 and any(each.level == "error" for each in findings):
            code = ExitCode.UNREACHABLE
    return findings, code


async def _looked(adapter: Adapter) -> tuple[list[Finding], Graph | None, int]:
    try:
        try:
            await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + OPEN_SECONDS)
            await adapter.wait_for_recordings()
        except RosError as error:
            return [Finding("error", "source", str(error))], None, code_of(error)
        graph = await _with_types(adapter)
        if isinstance(graph.state, Stale):
            return [Finding("error", "source", graph.state.why)], graph, int(ExitCode.UNREACHABLE)
        parts = {"node": graph.nodes.keys() - {graph.own_node}, "topic": graph.topics, "service": graph.services}
        counts = ", ".join(f"{len(names)} {kind}{'s'[: len(names) != 1]}" for kind, names in parts.items())
        findings = [Finding("ok", "source", f"{adapter.capabilities.system}: {counts}")]
        findings += graph_findings(graph)
        findings += await _type_findings(adapter, graph)
        is_recorded = bool(adapter.recordings) or adapter.catalogue is not None
        findings += _recording_findings(adapter) if is_recorded else await _clock_findings(adapter, graph)
        failed = next((each for each in findings if each.level == "error"), None)
        return findings, graph, 0 if failed is None else int(ExitCode.INPUT)
    finally:
        await adapter.close()


async def _with_types(adapter: Adapter) -> Graph:
    """Return the graph once the types of topics with several publishers are known, which ROS 1 learns from them."""

    def unknown() -> list[str]:
        several = (each for each in adapter.graph.topics.values() if len(each.publishers) > 1 and not _is_large(each))
        return [each.name for each in several if any(not (one.type or one.unreachable) for one in each.publishers)]

    is_live = adapter.capabilities.writes
    opened = [await adapter.subscribe(name) for name in (unknown()[:_COMPARED] if is_live else ())]
    for _ in range(round(_STAMP_SECONDS / _STEP) if opened else 0):
        if not unknown():
            break
        await asyncio.sleep(_STEP)
    graph = adapter.graph
    for subscription in opened:
        subscription.close()
    return graph


def _is_large(topic: Topic) -> bool:
    return any(ref.name.endswith(tuple(f"/{name}" for name in _LARGE)) for ref in topic.types)


def graph_findings(graph: Graph) -> Iterator[Finding]:
    """Yield what the graph says of nodes that do not answer, types that conflict, and qualities that do not fit."""
    silent = {node.name: node.unreachable for node in graph.nodes.values() if node.unreachable}
    for service in graph.services.values():
        silent |= {name: service.uncallable for name in service.providers if service.uncallable}
    for topic in graph.topics.values():
        silent |= {each.node: each.unreachable for each in topic.publishers if each.unreachable}
    for name, why in [*silent.items()][:_SHOWN]:
        step = "make its host name known (--host-map NAME=IP, /etc/hosts), and open its ports in the firewall"
        yield Finding("warning", "node", f"{name} does not answer: {why}", step)
    if len(silent) > _SHOWN:
        yield Finding("warning", "node", f"{len(silent) - _SHOWN} more nodes do not answer")
    for topic in graph.topics.values():
        if len(topic.types) > 1:
            names = ", ".join(" ".join(filter(None, (ref.name, ref.hash))) for ref in topic.types)
            step = "rebuild the nodes with the same version of the package"
            yield Finding("warning", "types", f"{topic.name} has several types: {names}", step)
        elif topic.unreadable:
            yield Finding("warning", "types", f"{topic.name} cannot be decoded: {topic.unreadable}")
        for each in mismatches(topic.publishers, topic.subscribers, 1):
            text = (
                f"{each.subscriber} gets no messages of {each.publisher} on {topic.name}: it requests {each.requested} "
            )
            yield Finding(
                "warning", "quality", f"{text}{each.policy}, offered is {each.offered}", "change either profile"
            )
    for action in graph.actions.values():
        if action.unusable:
            yield Finding("warning", "action", f"{action.name} cannot be used: {action.unusable}")


async def _type_findings(adapter: Adapter, graph: Graph) -> list[Finding]:
    deadline = asyncio.get_running_loop().time() + _TYPE_SECONDS

    async def missing(ref: TypeRef) -> str | None:
        try:
            await adapter.schema(ref, deadline=deadline)
        except UnknownType as error:
            return str(error)
        except RosError:
            pass  # a node that does not answer
        return None

    refs = sorted(types_in_use(graph), key=lambda ref: ref.name)
    words = [each for each in await asyncio.gather(*map(missing, refs)) if each is not None]
    step = "source the workspace that defines it, or name its folder with --types DIR"
    found = [Finding("warning", "types", each, step) for each in words[:_SHOWN]]
    if words or not refs:
        return found
    return [Finding("ok", "types", f"all {len(refs)} types are known")]


def _recording_findings(adapter: Adapter) -> list[Finding]:
    found: list[Finding] = []
    if adapter.catalogue is not None:
        bad = [each for each in adapter.catalogue.rows() if each.problem is not None]
        for row in bad[:_SHOWN]:
            found.append(Finding("warning", "recording", f"{row.path} cannot be read: {row.problem}"))
        if len(bad) > _SHOWN:
            found.append(Finding("warning", "recording", f"{len(bad) - _SHOWN} more cannot be read"))
        count = len(adapter.catalogue.names())
        text = f"{count} recordings; {count - len(bad)} can be read"
        return [*found, Finding("ok", "recording", text, "rosld index makes queries over them quick")]
    for recording in adapter.recordings.values():
        for note in getattr(recording, "notes", ()):
            step = "rosld cut FILE -o REPAIRED writes what can be read, with an index"
            found.append(Finding("warning", "recording", f"{recording.name}: {note}", step))
        length = duration_text((recording.end_ns - recording.start_ns) / 1e9)
        text = f"{recording.name}: {recording.format}, {recording.count:,} messages, {length}"
        found.append(Finding("ok" if recording.count else "warning", "recording", text))
    return found


async def _clock_findings(adapter: Adapter, graph: Graph) -> list[Finding]:
    """Compare the stamps of headers with this machine's clock, unless the robot's time is simulated."""
    has_clock = bool((clock := graph.topics.get("/clock")) and clock.publishers)
    if graph.simulated_time or has_clock:
        text = "the robot's time is simulated (/clock)"
        if has_clock:
            return [Finding("ok", "clock", text)]
        return [
            Finding("warning", "clock", "use_sim_time is true, but nothing publishes /clock", "start the simulation")
        ]
    ages = await _ages(adapter, [each for each in graph.topics.values() if await _is_stamped(adapter, each)][:_SHOWN])
    if not ages:
        if not graph.topics:
            return []
        return [Finding("ok", "clock", "not compared: no message with a stamp arrived")]
    apart = statistics.median(ages.values())
    if abs(apart) < _APART:
        return [Finding("ok", "clock", f"stamps are {apart:.2f} s old, of {len(ages)} topics")]
    side = "behind" if apart > 0 else "ahead of"
    text = f"stamps are {abs(apart):.1f} s {side} this machine's clock ({', '.join(ages)})"
    return [
        Finding("warning", "clock", text, "synchronize both clocks (chronyc tracking, timedatectl), or expect delays")
    ]


async def _is_stamped(adapter: Adapter, topic: Topic) -> bool:
    """Whether messages of a topic begin with a header, are small, and are sent again and again."""
    if topic.type is None or _is_large(topic):
        return False
    if not any(not (each.latched or each.unreachable) for each in topic.publishers):
        return False
    try:
        schema = await adapter.schema(topic.type, deadline=asyncio.get_running_loop().time() + 1.0)
    except RosError:
        return False
    fields = schema.type.fields if isinstance(schema, MessageSchema) else ()
    return bool(fields) and getattr(fields[0].type, "name", "") == _HEADER


async def _ages(adapter: Adapter, topics: Iterable[Topic]) -> dict[str, float]:
    """Return the seconds from the stamp of a new message to its arrival, by topic."""
    opened = {each.name: await adapter.subscribe(each.name) for each in topics}
    end = asyncio.get_running_loop().time() + _STAMP_SECONDS
    found: dict[str, float] = {}
    while len(found) < len(opened) and asyncio.get_running_loop().time() < end:
        await asyncio.sleep(_STEP)
        for name, subscription in opened.items():
            for sample in subscription.latest():
                if not sample.latched and (stamp := stamp_ns(sample)):
                    found.setdefault(name, (sample.received_ns - stamp) / 1e9)
    for subscription in opened.values():
        subscription.close()
    return found


def stamp_ns(sample: Sample) -> int:
    """Return the stamp of the header that a message begins with; 0 if it is not set.

    Both encodings have four bytes before it: the sequence number of ROS 1, the encapsulation of CDR.
    """
    order = ">" if sample.encoding is Encoding.CDR and sample.data[1:2] == b"\0" else "<"
    seconds, nanoseconds = struct.unpack_from(f"{order}II", sample.data, 4) if len(sample.data) >= 12 else (0, 0)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
