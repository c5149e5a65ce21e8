"""`rosld guard`: watches the rosld that serves a data folder, and ends its holds if it dies."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from pathlib import Path

from msgspec.structs import replace

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.model import RosError
from rosld.adapters.registry import adapter_for
from rosld.server.cli import data_folder
from rosld.server.cli.failure import end_signals, user_errors
from rosld.server.robot.hold_notes import HoldNote, HoldNotes
from rosld.server.robot.interrupted_holds import end_interrupted
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import end_tasks
from rosld.server.serving.http_server import configure_logging
from rosld.server.settings import Settings
from rosld.server.storage.files import FileLock

LOOK_SECONDS = 0.1
"""Interval of checks whether the watched rosld is alive."""
_SUBSCRIBER_SECONDS = 10.0
_ONCE_SECONDS = 30.0
"""Seconds that `--once` waits for a robot that does not answer; systemd kills after 90 s."""

_log = logging.getLogger("rosld")


def guard(source: str, folder: Path, options: AdapterOptions, *, once: bool) -> None:
    """Watch until a signal or, with `once`, until nothing is left to do. Raises Failure."""
    configure_logging()
    with user_errors():
        folder.mkdir(parents=True, exist_ok=True)
        adapter = adapter_for(source, options)
        asyncio.run(_run_guard(adapter, folder, once=once))


async def _run_guard(adapter: Adapter, folder: Path, *, once: bool) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in end_signals():
        loop.add_signal_handler(number, ended.set)
    notes, session = HoldNotes(folder), Session(adapter, Settings())
    try:
        await session.open()
        session.follow()
        watching = asyncio.ensure_future(_watch(session, notes, folder, once=once))
        ending = asyncio.ensure_future(ended.wait())
        await asyncio.wait([watching, ending], return_when=asyncio.FIRST_COMPLETED)
        await end_tasks((watching, ending))
        if not watching.cancelled():
            watching.result()  # raises the error of the watch
    finally:
        await session.close()


async def _watch(session: Session, notes: HoldNotes, folder: Path, *, once: bool) -> None:
    lock = FileLock(folder / data_folder.LOCK)
    was_served = True
    while True:
        is_served = _is_served(lock)
        if not is_served and (was_served or once):
            await _end_all(session, notes, folder, _ONCE_SECONDS if once else None)
        elif is_served and not was_served:
            _log.info("%s is being served again, watching it", folder)
        if once:
            return
        was_served = is_served
        await asyncio.sleep(LOOK_SECONDS)


def _is_served(lock: FileLock) -> bool:
    """Whether a living rosld serves the folder: it holds the lock, which its end always releases."""
    if not lock.acquire(shared=True):
        return True
    lock.release()
    return False


async def _end_all(session: Session, notes: HoldNotes, folder: Path, limit: float | None) -> None:
    left = [note for note in notes.read() if note.outcome is None]
    _log.info("%s is not being served; holds that could not be ended: %d", folder, len(left))
    ending = asyncio.gather(*(_end(session, notes, note) for note in left))
    with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
        await asyncio.wait_for(ending, limit)


async def _end(session: Session, notes: HoldNotes, note: HoldNote) -> None:
    outcome = await end_interrupted(session, note, _SUBSCRIBER_SECONDS, notes.reread)
    _log.warning("the hold %s of %s on %s, whose rosld was killed: %s", note.id, note.holder, note.topic, outcome.words)
    if note.data is not None and outcome.is_final:
        notes.write(replace(note, outcome=f"rosld guard: {outcome.words}"))
    if outcome.subscribers is not None:
        with contextlib.suppress(RosError):
            await session.adapter.unadvertise_always(note.topic)  # so that the next rosld is not a second publisher
