"""`rosld dump` and `rosld load`: all data stored by clients, as one archive."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

import click

from rosld.server.cli import data_folder
from rosld.server.cli.failure import Failure, user_errors
from rosld.server.settings import canonical_base
from rosld.server.storage.archive import ArchiveReader, pack
from rosld.server.storage.blobs import Blobs
from rosld.server.storage.record import StorageError
from rosld.server.storage.sqlite import BLOBS, CHECK_SECONDS


def dump(folder: Path, output: Path) -> None:
    """Write the records of a data folder, in use or not, to an archive. Raises Failure."""
    draft = output.with_name(f".{output.name}.{os.getpid()}")
    with user_errors():
        base = data_folder.read_base(folder)
        if base is None:
            raise Failure(f"{folder} is not a rosld data folder: {data_folder.NAME} is missing")
        try:
            with draft.open("wb") as file:
                packed = pack(folder, file, base)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(output)
        except StorageError as error:
            raise Failure(str(error)) from error
        finally:
            draft.unlink(missing_ok=True)
    click.echo(f"rosld: wrote {packed.records} resources, {packed.blobs} of them files, to {output}", err=True)


NOTICED_SECONDS = 4 * CHECK_SECONDS
"""Seconds after which a server on the folder reads the new records, and no old file any more."""


def load(archive: Path, folder: Path, base: str | None) -> None:
    """Replace everything in a data folder by the contents of a dump. Raises Failure, with nothing changed.

    `base` is the new prefix of its IRIs, by default that of an existing folder, or else that of the dump.
    """
    with user_errors(), archive.open("rb") as file:
        unpacking = ArchiveReader(file)
        owner = data_folder.read_base(folder)
        to = base or owner or canonical_base(unpacking.base)
        if to != unpacking.base and base is None:
            raise Failure(
                f"{archive} belongs to {unpacking.base}, the data in {folder} to {owner}: rewrite its IRIs with "
                f"--base-url {owner}, or load it into another folder"
            )
        data_folder.bind_base(folder, to)
        try:
            packed, freed = unpacking.restore_into(folder, to)
        except BaseException as error:
            if owner is None:
                data_folder.unbind(folder)
            if isinstance(error, StorageError):
                raise Failure(str(error)) from error
            raise
    click.echo(f"rosld: loaded {packed.records} resources, {packed.blobs} of them files, into {folder}", err=True)
    if freed:
        time.sleep(NOTICED_SECONDS)
        with contextlib.closing(Blobs(folder / BLOBS, durable=True)) as blobs:
            blobs.remove(freed)  # those that a process still uses are removed at the next start of a server
