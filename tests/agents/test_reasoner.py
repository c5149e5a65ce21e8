"""N3 rules and the EYE reasoner: requests follow from what the representations say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

RULES = Path(__file__).parent / "rules.n3"
PILOT = "http://example.org/pilot#"


def cruise(speed: float) -> str:
    """Return the mission as a fact."""
    return f"<{PILOT}Cruise> <{PILOT}speed> {speed:g} ."


def steps(lines: list[Any]) -> list[tuple[str, str]]:
    """Return the writes without repetitions: the last part of the URL, and the body or the status."""
    told = [
        (line["remembered"].removeprefix(PILOT), "")
        if "remembered" in line
        else (line["target"].rpartition("/")[2], line.get("body", ""))
        for line in lines
    ]
    return [step for number, step in enumerate(told) if number == 0 or told[number - 1] != step]


def test_rules_fly_the_aircraft(aircraft: Any, run_node: Callable[..., Any]) -> None:
    code, lines = run_node("reasoner.mjs", aircraft.url, str(RULES), cruise(20))
    assert code == 0, lines
    flown = [("start", ""), ("speed", "20"), ("Cruised", ""), ("speed", "0"), ("stop", ""), ("Landed", "")]
    assert steps(lines) == flown
    assert {line.get("status", 200) for line in lines} <= {200, 204}
    assert (aircraft.power, aircraft.speed) == ("off", 0.0)
