"""The rover driven from its page, in a real browser: it moves while the pad is pressed, and not a moment longer."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rosld.adapters.rover.topics import CMD_VEL
from tests.rover.rovers import Rover
from tests.server.html.conftest import browser, tab, window
from tests.waiting import until

__all__ = ["browser", "tab", "window"]

pytestmark = pytest.mark.slow

STICK = "document.querySelector('.stick')"


def mouse(tab: Any, kind: str, left: float, ahead: float) -> None:
    """The mouse at a place of the pad."""
    rect = json.loads(tab.run(f"JSON.stringify({STICK}.getBoundingClientRect())"))
    x, y = (rect[start] + rect[size] * (1 - part) / 2 for start, size, part in
            (("left", "width", left), ("top", "height", ahead)))  # fmt: skip
    tab.send("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, x=x, y=y)


def turns(rover: Rover, tab: Any) -> bool:
    """Whether it turns to the left, with the pad pressed: anew where a busy machine let the lease lapse."""
    if not tab.run(f"{STICK}.hasAttribute('data-pressed')"):
        mouse(tab, "mouseReleased", 0.95, 0.0)
        mouse(tab, "mousePressed", 0.95, 0.0)
    return rover.velocity()[1] > 0.3


def test_the_rover_turns_while_the_pad_is_pressed_and_stands_when_it_is_let_go_or_the_page_is_lost(
    rover: Rover, tab: Any
) -> None:
    for leave in (False, True):
        tab.open(f"{rover.url}topics{CMD_VEL}")
        tab.until(STICK)
        tab.run(f"void {STICK}.scrollIntoView({{block: 'center'}})")
        until(lambda: turns(rover, tab), "a turn to the left")
        if leave:
            tab.open(f"{rover.url}topics/odom")
        else:
            mouse(tab, "mouseReleased", 0.95, 0.0)
        rover.stands()
    until(lambda: rover.http.put(f"/topics{CMD_VEL}", json={}).status_code == 204, "the end of the hold")
