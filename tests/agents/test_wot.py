"""node-wot, a third-party client of the Web of Things, with the Thing Descriptions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.slow

CRUISE = 40


def test_node_wot_reads_writes_and_invokes(aircraft: Any, run_node: Callable[..., Any]) -> None:
    code, lines = run_node("wot.mjs", aircraft.url, str(CRUISE))
    assert code == 0, lines
    observed = next(line["observed"] for line in lines if "observed" in line)
    assert CRUISE in observed
    assert observed[-1] == 0
    assert any(0 < speed < CRUISE for speed in observed), observed
    assert [line for line in lines if "observed" not in line] == [
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
