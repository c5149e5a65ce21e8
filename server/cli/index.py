"""`rosld index`: the catalogue and the statistics of recordings, made before a server needs them."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

import click

from rosld.adapters.base import AdapterOptions, Recording
from rosld.adapters.model import RosError
from rosld.server.cli.failure import ExitCode, Failure, user_errors
from rosld.server.cli.list_types import open_source
from rosld.server.cli.workers import usable_cores
from rosld.server.history.statistics import ByType, Statistics, index_file

_METADATA = "metadata.yaml"
"""File that makes a folder a recording of rosbag2."""


def index(paths: Sequence[Path], options: AdapterOptions, workers: int | None) -> None:
    """Catalogue the recordings in folders, and make their statistics. Raises Failure if some cannot be read."""
    wanted = [path.expanduser().absolute() for path in paths]
    roots = dict.fromkeys(
        path if path.is_dir() and not (path / _METADATA).is_file() else path.parent for path in wanted
    )
    with user_errors(ExitCode.USAGE), open_source("\n".join(map(str, roots)), options) as adapter:
        path = None if adapter.catalogue is None else adapter.catalogue.path
        if path is None:
            raise Failure("The catalogue cannot be written in the first folder: choose another with --data DIR.")
        statistics = Statistics(path)
        recordings = [one for one in adapter.recordings.values() if any(_is_below(one.path, each) for each in wanted)]
        try:
            failures = _index(recordings, statistics, options, workers or usable_cores())
        finally:
            statistics.close()
    for each in failures:
        click.echo(f"rosld: {each}", err=True)
    click.echo(f"{len(recordings) - len(failures)} recordings are indexed in {path}")
    if failures:
        raise Failure(f"{len(failures)} recordings cannot be read", ExitCode.INCOMPLETE)


def _is_below(path: Path, folder: Path) -> bool:
    return path == folder or folder in path.parents


def _index(recordings: Sequence[Recording], statistics: Statistics, options: AdapterOptions, workers: int) -> list[str]:
    """Make the statistics that are not known; return why others cannot be made."""
    failures: list[str] = []
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["rosld.server.history.statistics"])
    with ProcessPoolExecutor(workers, context) as pool:
        running: dict[Future[dict[str, ByType]], tuple[Recording, str]] = {}
        for one in recordings:
            key = one.content
            missing = [] if key is None else statistics.missing(key, one.topics)
            if key is not None and missing:
                running[pool.submit(index_file, one.path, options, missing)] = (one, key)
        with click.progressbar(length=len(running), label="index", show_pos=True) as bar:
            for future in as_completed(running):
                one, key = running.pop(future)
                try:
                    for topic, found in future.result().items():
                        statistics.keep(key, topic, found)
                except (RosError, OSError) as error:
                    failures.append(f"{one.path}: {error}")
                bar.update(1)
    return failures
