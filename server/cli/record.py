"""`rosld record`: records live topics of a source into an MCAP file, a ROS 1 bag or a ROS 2 bag folder."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import click

from rosld.adapters.base import Adapter, AdapterOptions, NullSink
from rosld.adapters.model import Encoding, Graph, RosError
from rosld.adapters.registry import adapter_for
from rosld.server.cli.failure import ExitCode, Failure, end_signals, user_errors
from rosld.server.cli.list_types import open_at_once
from rosld.server.history.bag_export import BAG, ROSBAG2, CannotExport, export
from rosld.server.history.history_writer import require_room
from rosld.server.history.recording_writer import RecordingWriter
from rosld.server.history.recordings import SUFFIX
from rosld.server.history.topic_feed import LiveRecorder
from rosld.server.robot.schemas import Schemas
from rosld.server.settings import check_topic_glob

_PROGRESS_SECONDS = 1.0
STDOUT = Path("-")
"""Name of the output that is written to stdout."""


def record(source: str, output: Path, topics: Sequence[str], duration: float | None, options: AdapterOptions) -> None:
    """Record until a signal, or for `duration` seconds, with progress on stderr. Raises Failure."""
    file = mcap_file(output)
    if output == STDOUT:
        require_pipe()
    for path in {output, file} - {STDOUT}:
        if path.exists():
            raise Failure(f"{path} already exists: choose another file", ExitCode.OUTPUT)
    with user_errors(ExitCode.USAGE):
        for glob in topics:
            check_topic_glob("--topic", glob)
        adapter = adapter_for(source, options)
        if adapter.capabilities.system == "recording":
            raise ValueError(_not_live(source))
        require_format(output, adapter.capabilities.encoding)
        writer = asyncio.run(_Recording(adapter, file, topics or ("*",)).run(duration))
    if writer.problem is not None:
        raise Failure(writer.problem, ExitCode.INCOMPLETE)
    if file != output:
        try:
            convert(file, output, options)
        except (OSError, RosError, CannotExport) as error:
            words = f"{output} cannot be written: {error}; the recording is in {file}"
            raise Failure(words, ExitCode.OUTPUT) from error
        file.unlink()
    if writer.silent:
        click.echo(f"rosld: no messages received on {', '.join(writer.silent)}", err=True)
    click.echo(f"{output}: {writer.count} messages on {len(writer.counts)} topics", err=True)


def mcap_file(output: Path) -> Path:
    """Return the file that is written first: the output, or a temporary one to convert at the end."""
    return output if output.suffix == SUFFIX or output == STDOUT else output.with_name(f"{output.name}{SUFFIX}")


def require_pipe() -> None:
    """Raise Failure if stdout is a terminal, to which no recording is written."""
    if sys.stdout.isatty():
        raise Failure("-o - writes bytes: redirect them to a file or a pipe", ExitCode.USAGE)


def require_format(output: Path, encoding: Encoding) -> None:
    """Raise ValueError if the name of the output has no known format, or that of the other ROS version."""
    own = "FILE.bag, a ROS 1 bag" if encoding is Encoding.ROS1 else "FOLDER, a ROS 2 bag"
    if output == STDOUT or output.suffix in (SUFFIX, BAG.suffix if encoding is Encoding.ROS1 else ""):
        return
    version = 1 if encoding is Encoding.ROS1 else 2
    raise ValueError(f"-o {output}: the messages are of ROS {version}; use FILE.mcap or {own}")


def convert(file: Path, output: Path, options: AdapterOptions) -> None:
    """Convert the recording to the format of the output's name. Raises OSError, RosError and CannotExport."""
    wanted = BAG if output.suffix == BAG.suffix else ROSBAG2
    export(file, output, wanted, AdapterOptions(types=options.types))


def _not_live(source: str) -> str:
    """Return why a source that is read as the path of a recording cannot be recorded."""
    path = source.removeprefix("recording:").partition("?")[0]
    if Path(path).exists():
        return f"{source} is already a recording"
    return f"{source} is not a live source, such as ros1://HOST:PORT, ros2: or rover"


class _Recording(NullSink):
    """One recording of an adapter opened for it, and the sink of that adapter."""

    def __init__(self, adapter: Adapter, output: Path, topics: Sequence[str]) -> None:
        self._adapter = adapter
        self._output = output
        self._topics = topics
        self._schemas = Schemas(adapter)
        self._live = LiveRecorder(adapter, self._schemas.get)
        self._loop: asyncio.AbstractEventLoop | None = None

    async def run(self, duration: float | None) -> RecordingWriter:
        loop = self._loop = asyncio.get_running_loop()
        ended = asyncio.Event()
        for number in end_signals():
            loop.add_signal_handler(number, ended.set)
        await open_at_once(self._adapter, self)
        try:
            writer = RecordingWriter(
                self._output,
                self._adapter.capabilities.encoding,
                self._schemas.definition_of,
                require_room,
                stream=sys.stdout.buffer if self._output == STDOUT else None,
            )
            self._live.add(writer, lambda topic: any(fnmatchcase(topic, glob) for glob in self._topics))
            progress = loop.create_task(self._report_progress(writer, ended))
            with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
                await asyncio.wait_for(ended.wait(), duration)
            progress.cancel()
            writer.silent = self._live.silent(writer, self._topics, writer.counts)
            await self._live.remove(writer)
            await self._live.stop()
        finally:
            await self._adapter.close()
        for topic, count in sorted(self._live.dropped().items()):
            click.echo(f"rosld: {count} messages on {topic} arrived too fast and were dropped", err=True)
        return writer

    def graph_changed(self, graph: Graph) -> None:
        """Follow new topics after a change of the graph."""
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._live.feed.refresh)

    async def _report_progress(self, writer: RecordingWriter, ended: asyncio.Event) -> None:
        """Report the progress in one line of a terminal (and only there); end with the recording."""
        is_terminal = os.isatty(sys.stderr.fileno())
        while True:
            await asyncio.sleep(_PROGRESS_SECONDS)
            if writer.problem is not None:
                ended.set()
            if is_terminal:
                line = f"{writer.count} messages on {len(writer.counts)} topics, {writer.size / 1e6:.1f} MB"
                click.echo(f"\r{line}\x1b[K", err=True, nl=False)
