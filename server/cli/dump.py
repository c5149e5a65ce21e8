"""`rosld dump`: write all that clients have stored to one archive, which appears once it is complete."""

from __future__ import annotations

import os
from pathlib import Path

import click

from rosld.server.cli import data_folder
from rosld.server.cli.failure import Failure, user_errors
from rosld.server.storage.archive import pack
from rosld.server.storage.record import StorageError


def dump(folder: Path, output: Path) -> None:
    """Write the records of a data folder, whether a server runs on it or not. Raises Failure."""
    draft = output.with_name(f".{output.name}.{os.getpid()}")
    with user_errors():
        base = data_folder.read_base(folder)
        if base is None:
            raise Failure(f"{folder} is no folder that rosld keeps data in: {data_folder.NAME} is missing")
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
    click.echo(f"rosld: {packed.records} resources, {packed.blobs} of them files, are in {output}", err=True)
