"""node-wot, a third-party client of the Web of Things, with the Thing Descriptions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.server.auth.conftest import rule, token, tokens

pytestmark = pytest.mark.slow

CRUISE = 40


def test_node_wot_reads_writes_and_invokes(aircraft: Any, run_node: Callable[..., Any]) -> None:
    code, lines = run_node("wot.mjs", aircraft.url, str(CRUISE))
    assert code == 0, lines
    (observed,) = (line["observed"] for line in lines if "observed" in line)
    (heard,) = (line["heard"] for line in lines if "heard" in line)
    assert (heard[0], heard[-1]) == ("on", "off")
    assert CRUISE in observed
    assert observed[-1] == 0
    assert any(0 < speed < CRUISE for speed in observed), observed
    assert [line for line in lines if not {"observed", "heard"} & line.keys()] == [
        {"power": "off"},
        {"refused": "stop", "error": "Client error: Conflict"},
        {"started": {"power": "on"}},
        {"refused": "start", "error": "Client error: Conflict"},
        {"things": ["Aircraft", "Engine"], "bounds": [0, 1000]},
        {"refused": "too fast", "error": "Client error: Unprocessable Entity"},
        {"speed": CRUISE},
        {"speed": 0},
        {"stopped": {"power": "off"}},
        {"power": "off"},
    ]
    assert aircraft.power == "off"


@pytest.fixture
def auth(tmp_path: Path) -> Path:
    """Rules for one agent, the pilot, who may read and command everything."""
    path = tmp_path / "auth.toml"
    path.write_text(tokens("pilot") + rule("pilot", "read control", "/**"))
    return path


def test_node_wot_reads_every_property_with_its_token_where_clients_are_authenticated(
    start_server: Callable[..., Any], run_node: Callable[..., Any], auth: Path
) -> None:
    code, [read] = run_node("things.mjs", start_server("aircraft", "--auth", str(auth)).url, token("pilot"))
    assert code == 0
    assert read["security"] == ["bearer_sc"]
    assert len(read["values"]) == 13
    assert (read["values"]["aircraft/power"], read["values"]["aircraft/fly/feedback"]) == ("on", None)


@pytest.mark.parametrize(("robot", "is_guarded"), [("aircraft", False), ("rover", True)])
def test_the_playground_finds_nothing_wrong_with_any_thing_description(
    start_server: Callable[..., Any], run_node: Callable[..., Any], auth: Path, robot: str, is_guarded: bool
) -> None:
    arguments, credentials = (("--auth", str(auth)), (token("pilot"),)) if is_guarded else ((), ())
    code, lines = run_node("playground.mjs", start_server(robot, *arguments).url, *credentials)
    assert code == 0, lines
    assert len(lines) > 2
    assert all((each["json"], each["schema"], each["failed"]) == ("passed", "passed", []) for each in lines), lines
