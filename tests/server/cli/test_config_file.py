"""Settings from the file of `--config` and from the environment: precedence, and places of errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from rosld.server.cli import serve as serving
from rosld.server.cli.main import main
from rosld.server.settings import Settings


class Started(dict[str, Any]):
    """The source and the settings with which `rosld serve` would start."""


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Started:
    found = Started()
    monkeypatch.setattr(serving, "serve", lambda source, settings, **more: found.update(source=source, given=settings))
    return found


def serve(folder: Path, text: str, *arguments: str, **environment: str) -> Result:
    """Run `rosld serve --config` with a file of this text."""
    file = folder / "rosld.toml"
    file.write_text(text, "utf-8")
    return CliRunner().invoke(main, ["serve", "--config", str(file), *arguments], env=environment)


def given(found: Started) -> Settings:
    settings: Settings = found["given"]
    return settings


def test_the_file_gives_settings_of_all_types_by_name(tmp_path: Path, started: Started) -> None:
    text = """
        source = "aircraft"
        base_url = "http://robot.example"
        port = 80
        idle_time = 5
        body_limit = 2048
        read_only = true
        data = "stored"
        subscribe = ["/a", "/b"]
        getter = "read_{name}"
        host_map = ["robot=10.0.0.1"]
        "name" = 'Ada # 1'
    """
    result = serve(tmp_path, text)
    assert result.exit_code == 0, result.output
    assert result.stderr == f"rosld: settings from {tmp_path / 'rosld.toml'}\n"
    assert started["source"] == "aircraft"
    expected = Settings(
        base_url="http://robot.example/",
        port=80,
        idle_time=5.0,
        body_limit=2048,
        read_only=True,
        data=tmp_path / "stored",
        subscribe=("/a", "/b"),
        getter=("read_{name}",),
        host_map=(("robot", "10.0.0.1"),),
        name="Ada # 1",
    )
    assert given(started) == expected


def test_an_option_precedes_the_environment_and_that_the_file(tmp_path: Path, started: Started) -> None:
    text = 'source = "aircraft"\nport = 1\nbody_limit = 2001\nhistory = ["*"]\nfreshness = 1\n'
    environment = {"ROSLD_PORT": "2", "ROSLD_BODY_LIMIT": "2002", "ROSLD_HISTORY": "/a /b", "ROSLD_SOURCE": "rover"}
    assert serve(tmp_path, text, **environment).exit_code == 0
    assert (given(started).port, given(started).body_limit, given(started).history) == (2, 2002, ("/a", "/b"))
    assert (started["source"], given(started).freshness) == ("rover", 1.0)
    options = ("--port", "3", "--setting", "body-limit", "2003", "--history", "/c")
    assert serve(tmp_path, text, "aircraft", *options, **environment).exit_code == 0
    assert (given(started).port, given(started).body_limit, given(started).history) == (3, 2003, ("/c",))
    assert started["source"] == "aircraft"


def test_the_environment_needs_no_file(started: Started) -> None:
    environment = {"ROSLD_SOURCE": "ros1://robot:11311", "ROSLD_READ_ONLY": "true", "ROSLD_PROT": "1"}
    result = CliRunner().invoke(main, ["serve"], env=environment)
    assert (result.exit_code, started["source"], given(started).read_only) == (0, "ros1://robot:11311", True)
    assert result.stderr == "rosld: ROSLD_PROT is not a setting: did you mean ROSLD_PORT?\n"


def test_a_file_in_the_working_folder_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, started: Started
) -> None:
    (tmp_path / "rosld.toml").write_text("port = 1\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(main, ["serve", "aircraft"]).exit_code == 0
    assert given(started).port == 8080


def test_recordings_are_relative_to_the_file(tmp_path: Path, started: Started) -> None:
    assert serve(tmp_path, 'source = ["run.bag", "more/*.mcap"]').exit_code == 0
    assert started["source"] == f"recording:{tmp_path / 'run.bag'}\n{tmp_path / 'more/*.mcap'}"


WRONG = (
    ("read-only = true", "1:1: read-only is not a setting: did you mean read_only?"),
    ("\n  xyzzy = 1", "2:3: xyzzy is not a setting; "),
    ("[topics]\na = 1", "1:2: topics is not a setting"),
    ('port = "80"', "1:8: port must be a whole number, not the string '80'"),
    ("port = 80.5", "1:8: port must be a whole number, not the number 80.5"),
    ("port = true", "1:8: port must be a whole number, not the boolean true"),
    ("read_only = 1", "1:13: read_only must be true or false, not the number 1"),
    ("name = 1", "1:8: name must be a string, not the number 1"),
    ('idle_time = "x"', "1:13: idle_time must be a number, not the string 'x'"),
    ("history = [1]", "1:11: history must be a list of strings, not the list [1]"),
    ("\n\nport =   70000", "3:10: port 70000: must be at most 65535"),
    ('history = [\n  "scan"]', "1:11: history scan: must begin with a slash or a star"),
    ("body_limit = 1", "1:14: body_limit 1: must be at least 1024"),
    ('stop_cancels = "all"', "1:16: stop_cancels all: must be own or others"),
    ('auth = "none.toml"', "1:8: auth: File "),
    ('qos = ["x=y"]', "1:7: qos: 'x=y' is not GLOB=PROFILE"),
    ("port = 1\nport = 2", "2:9: cannot overwrite a value"),
    ("port =", "1:7: invalid value"),
    ("source = 1", "1:10: source must be a source"),
    ("[robots]\narm = 1", "1:2: robots must be a table of sources"),
)


def test_what_is_wrong_in_the_file_is_refused_with_its_place(tmp_path: Path, started: Started) -> None:
    for text, words in WRONG:
        result = serve(tmp_path, text, "aircraft")
        assert result.exit_code == 2, text
        assert f"rosld: {tmp_path / 'rosld.toml'}:{words}" in result.stderr, (text, result.stderr)
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe4"')
    result = CliRunner().invoke(main, ["serve", "aircraft", "--config", str(tmp_path / "latin.toml")])
    assert (result.exit_code, "not UTF-8 at byte 8" in result.stderr) == (2, True)
    assert not started


def test_what_is_wrong_in_the_environment_is_refused_with_its_variable() -> None:
    for name, value, words in (
        ("ROSLD_PORT", "x", "ROSLD_PORT: port: 'x' is not a valid integer"),
        ("ROSLD_PORT", "70000", "ROSLD_PORT: port 70000: must be at most 65535"),
        ("ROSLD_BODY_LIMIT", "much", "ROSLD_BODY_LIMIT: body_limit must be a number, not 'much'"),
    ):
        result = CliRunner().invoke(main, ["serve", "aircraft"], env={name: value})
        assert (result.exit_code, words in result.stderr) == (2, True), result.stderr
    result = CliRunner().invoke(main, ["serve", "aircraft", "--port", "70000"], env={"ROSLD_PORT": "1"})
    assert result.stderr == "rosld: --port 70000: must be at most 65535\n"
