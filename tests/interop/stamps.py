"""Folders derived once from files: by one process at a time, and again when the files have changed."""

from __future__ import annotations

import fcntl
import hashlib
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def made_once(folder: Path, inputs: Sequence[Path]) -> Iterator[bool]:
    """Whether the folder is up to date. If not, it is emptied, and marked as up to date when the body is done."""
    folder.parent.mkdir(exist_ok=True)
    with folder.with_name(f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # ends with the process in any case
        wanted = hashlib.sha256(b"".join(path.read_bytes() for path in inputs)).hexdigest()
        stamp = folder / ".made-from"
        fresh = stamp.exists() and stamp.read_text() == wanted
        if not fresh:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield fresh
        if folder.exists():
            stamp.write_text(wanted)
