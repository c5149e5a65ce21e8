"""The folder of --data belongs to one base, and is served by one process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from rosld.server.cli.data_folder import lock, read_base
from rosld.server.cli.main import main

HOLDER = """
import os, sys
from pathlib import Path
from rosld.server.cli.data_folder import lock
with lock(Path(sys.argv[1])):
    if len(sys.argv) > 2 and os.fork() == 0:
        os.read(int(sys.argv[2]), 1)  # a child that goes on when its parent is dead
        os._exit(0)
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def holding(folder: Path, *more: str, pass_fds: tuple[int, ...] = ()) -> Iterator[subprocess.Popen[str]]:
    """Run a process that uses a folder; end it afterwards, by force if necessary."""
    command = [sys.executable, "-c", HOLDER, str(folder), *more]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=pass_fds
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


@pytest.mark.slow
def test_a_second_server_on_a_folder_says_who_serves_it(tmp_path: Path) -> None:
    with holding(tmp_path) as process:
        result = CliRunner().invoke(main, ["serve", "aircraft", "--port", "0", "--data", str(tmp_path)])
        assert result.exit_code == 1
        assert result.stderr.startswith(f"rosld: {tmp_path} is served by another rosld (process {process.pid})")
        assert result.stderr.count("\n") == 1
        assert read_base(tmp_path) is None


@pytest.mark.slow
def test_what_a_killed_process_left_behind_is_no_obstacle(tmp_path: Path) -> None:
    with holding(tmp_path) as process:
        process.kill()
        process.wait()
        assert (tmp_path / "lock").read_text() == f"{process.pid}\n"
        with lock(tmp_path):
            pass


@pytest.mark.slow
def test_a_child_that_outlives_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    end, begin = os.pipe()
    try:
        with holding(tmp_path, str(end), pass_fds=(end,)) as process:
            process.kill()
            process.wait()
            with lock(tmp_path):
                pass
            os.write(begin, b"x")
    finally:
        os.close(end)
        os.close(begin)
