"""`rosld serve` as a process: its output, its errors, its end."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from click.testing import CliRunner, Result

from rosld.server.cli.main import main
from rosld.server.runtime.tasks import end_tasks
from tests.forked import ForkedCommand
from tests.server.conftest import Served
from tests.waiting import until

pytestmark = pytest.mark.slow

PATIENCE = 60.0


def failure(*arguments: str, code: int = 1) -> Result:
    """Return the error of a failing `rosld serve`, after checking that it is one line without a traceback."""
    result = CliRunner().invoke(main, ["serve", *arguments])
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("rosld: ")
    assert result.stderr.count("\n") == 1
    return result


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_it_prints_its_url_and_nothing_else_and_ends_in_time_with_clients_connected(
    serve: Callable[..., Served], capfd: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    served = serve("aircraft", process=True)
    assert isinstance(served.process, ForkedCommand)
    assert served.http.get("/", headers={"Accept": "text/turtle"}).status_code == 200
    parts = urlsplit(served.url)
    with closing(socket.create_connection((parts.hostname, parts.port))) as unfinished:
        head = f"PUT /topics/cockpit/display HTTP/1.1\r\nHost: {parts.netloc}\r\nContent-Type: application/json\r\n"
        unfinished.sendall(f"{head}Content-Length: 100\r\n\r\n{{".encode())
        assert served.http.get("/").status_code == 200  # so that the server has received the unfinished request
        served.process.send_signal(number)
        assert served.process.stdout.read() == ""
        assert served.process.wait(PATIENCE) == 0
    assert "Traceback" not in capfd.readouterr().err


def test_started_by_nohup_it_outlives_its_terminal() -> None:
    command = [sys.executable, "-m", "rosld", "serve", "aircraft", "--port", "0"]
    with subprocess.Popen(["nohup", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            process.send_signal(signal.SIGHUP)
            assert httpx.get(url, timeout=10).status_code == 200
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()


def test_it_may_be_told_to_end_before_it_has_begun(capfd: pytest.CaptureFixture[str]) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        silent.settimeout(20)
        process = ForkedCommand("serve", f"ros1://127.0.0.1:{silent.getsockname()[1]}", "--port", "0")
        try:
            connection, _ = silent.accept()  # it is opening its source now
            with closing(connection):
                process.send_signal(signal.SIGTERM)
                assert process.stdout.read() == ""
        finally:
            process.kill()
            process.wait(PATIENCE)
    assert "Traceback" not in capfd.readouterr().err


def test_a_ros_1_robot_that_is_off_is_waited_for_which_is_said_everywhere(
    tmp_path: Path, serve: Callable[..., Served], capfd: pytest.CaptureFixture[str]
) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as closed:
        host, source = "127.0.0.1", f"ros1://127.0.0.1:{closed.getsockname()[1]}"
    http = serve(source, process=True).http
    robot = http.get("/status", headers={"Accept": "application/json"}).json()["robot"]
    assert robot["state"] == "Stale"
    assert robot["staleSince"]
    assert host in robot["reason"]
    until(lambda: robot["reason"] in capfd.readouterr().err, "a line in the log")
    for path in ("/", "/status"):
        assert robot["reason"] in http.get(path, headers={"Accept": "text/turtle"}).text
    assert "The robot cannot be reached" in http.get("/", headers={"Accept": "text/html"}).text
    for command in (["types", source], ["record", source, "-o", str(tmp_path / "x.mcap")]):
        done = CliRunner().invoke(main, command)  # requests that do not wait for a robot end
        assert (done.exit_code, host in done.stderr, done.stderr.count("\n")) == (4, True, 1), done.stderr


def test_a_server_that_cannot_begin_says_why_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.bag").write_text("this is no recording")
    (tmp_path / "base-url").write_text("http://robot.example/\n")
    other = ("--base-url", "http://other.example/", "--data", str(tmp_path))
    forbidden = ("--host", "192.0.2.1") if os.geteuid() == 0 else ("--port", "1")
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = str(taken.getsockname()[1])
        for arguments, code, words in (
            (("aircraft", "--port", port), 1, f"127.0.0.1:{port}"),
            (("aircraft", *forbidden), 1, "192.0.2.1" if os.geteuid() == 0 else "ermission"),
            (("aircraft", "--host", "no.such.host.invalid"), 1, "no.such.host.invalid"),
            (("aircraft", "--host", "0.0.0.0"), 1, "--base-url"),
            (("aircraft", *other), 1, "http://robot.example/"),
            (("no-such.bag",), 3, "no-such.bag"),
            ((str(tmp_path / "text.bag"),), 3, "text.bag"),
            (("telepathy://robot",), 1, "telepathy"),
            (("aircraft", "--setting", "nonsense", "1"), 2, "nonsense"),
            (("aircraft", "--setting", "body_limit", "much"), 2, "body_limit"),
            (("aircraft", "--rate", "0"), 2, "rate"),
            (("aircraft", "--cors-origin", "nonsense"), 2, "nonsense"),
            (("aircraft", "--base-url", "nonsense"), 2, "nonsense"),
        ):
            assert words in failure("--port", "0", *arguments, code=code).stderr, arguments


def test_an_option_that_is_none_or_a_glob_that_a_shell_has_replaced_is_a_usage_error() -> None:
    for arguments, words in (
        (("serve", "aircraft", "--host-map", "nonsense"), "Usage"),
        (("serve", "aircraft", "--port", "many"), "Usage"),
        (("serve", "aircraft", "--nonsense"), "Usage"),
        (("serve", "rover", "--history", "docs", "README.md"), "Quote globs, such as --history '*'"),
        (("record", "rover", "-o", "x.mcap", "--topic", "a", "b"), "Quote globs, such as --history '*'"),
    ):
        result = CliRunner().invoke(main, arguments)
        assert (result.exit_code, words in result.stderr) == (2, True), arguments


def test_help_explains_itself_with_examples_and_the_version_is_printed() -> None:
    for arguments in (["--help"], ["serve", "--help"], ["lift", "--help"], ["types", "--help"]):
        result = CliRunner().invoke(main, arguments)
        assert result.exit_code == 0
        assert "rosld " in result.output
    assert CliRunner().invoke(main, ["--version"]).output.startswith("rosld 0.")


def test_types_lists_names_and_hashes() -> None:
    result = CliRunner().invoke(main, ["types", "aircraft"])
    assert "std_msgs/msg/Float64\tfdb28210bfa9d7c91146260178d9a584\n" in result.output
    listed = json.loads(CliRunner().invoke(main, ["types", "aircraft", "--json"]).stdout)
    assert {"name": "std_msgs/msg/Float64", "hash": "fdb28210bfa9d7c91146260178d9a584"} in listed
    missing = CliRunner().invoke(main, ["types", "no-such.bag"])
    assert (missing.exit_code, missing.stdout, missing.stderr.count("\n")) == (3, "", 1)


def test_a_background_task_ends_though_its_wait_is_over_just_as_it_is_cancelled() -> None:
    async def cancelled() -> bool:
        event = asyncio.Event()

        async def wait_for_ever() -> None:
            while True:
                await asyncio.wait_for(event.wait(), PATIENCE)
                event.clear()

        task = asyncio.create_task(wait_for_ever())
        for step in range(4):  # the event loop has noticed the event, but the task has not yet
            await asyncio.sleep(0)
            if step == 1:
                event.set()
        await end_tasks([task])
        return task.cancelled()

    assert asyncio.run(asyncio.wait_for(cancelled(), PATIENCE))
