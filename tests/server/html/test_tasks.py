"""Number of clicks that a person needs for tasks in a real browser, on a robot without a mapping."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from tests.server.conftest import Served
from tests.stopping import release

pytestmark = pytest.mark.slow

BOX = "document.querySelector('form.find input')"
NOTICE = "document.querySelector('.notice.good')?.textContent"


class Person:
    """A person with a mouse and a keyboard, who starts at the entry; `clicks` are counted, typing is not."""

    def __init__(self, tab: Any, url: str) -> None:
        self.tab = tab
        self.clicks = 0
        tab.send("Emulation.setDeviceMetricsOverride", width=1280, height=900, deviceScaleFactor=1, mobile=False)
        tab.open(url)

    def _place(self, element: str) -> dict[str, float]:
        """Return the position of an element in the window, once it exists and is at rest."""
        self.tab.until(f"{element} && !{element}.closest('[inert]')")
        self.tab.run(f"void {element}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
        box = json.loads(self.tab.run(f"JSON.stringify({element}.getBoundingClientRect())"))
        return {"x": box["left"] + box["width"] / 2, "y": box["top"] + box["height"] / 2}

    def click(self, element: str) -> None:
        """Click on an element of the page."""
        self.clicks += 1
        self.tab.press(**self._place(element))

    def follow(self, element: str) -> None:
        """Click on an element that leads to another page."""
        self.clicks += 1
        self.tab.follow(**self._place(element))

    def type(self, element: str, text: str) -> None:
        """Click into a field, and replace its content."""
        self.click(element)
        self.tab.run(f"void {element}.select()")
        self.tab.type(text)

    def find(self, words: str, name: str) -> None:
        """Search for words, and open the result with this name."""
        self.type(BOX, words)
        called = f"(each) => each.querySelector('bdi').textContent === '{name}'"
        self.follow(f"[...document.querySelectorAll('.suggestions a')].find({called})")

    def reads(self, field: str) -> str:
        """Return JavaScript for the text that the page shows for a field of a message."""
        return f"document.querySelector('[data-key=\"{field}\"] .value')?.textContent"


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Served]) -> Served:
    return start_server("rover:?battery=0.5")


@pytest.fixture
def person(tab: Any, rover: Served) -> Person:
    return Person(tab, rover.url)


def test_to_drive_and_to_stop_takes_four_clicks(person: Person, rover: Served) -> None:
    person.find("twist", "/cmd_vel")
    stick = "document.querySelector('.stick')"
    at = person._place(stick)
    person.clicks += 1
    ahead = {"x": at["x"], "y": at["y"] - 60}
    person.tab.send("Input.dispatchMouseEvent", type="mousePressed", button="left", buttons=1, clickCount=1, **ahead)
    person.tab.until("document.querySelector('.driving').textContent === 'Driving'")
    person.tab.send("Input.dispatchMouseEvent", type="mouseReleased", button="left", clickCount=1, **ahead)
    person.follow("document.querySelector('form.stop button')")
    person.tab.until("document.querySelector('.notice.stopped')")
    assert person.clicks == 4
    assert release(rover.http).status_code == 204


def test_to_send_a_goal_and_see_it_fail_takes_four_clicks(person: Person) -> None:
    person.find("navigate", "/navigate_to")
    field = "document.querySelector('input[name=\"pose.pose.position.x\"]')"
    person.type(field, "90")
    person.follow(f"{field}.form.querySelector('button')")
    person.tab.until("/aborted/.test(document.querySelector('main').textContent)")
    assert person.clicks == 4


def test_to_set_a_parameter_within_its_range_takes_four_clicks(person: Person) -> None:
    person.find("max_speed", "/rover/max_speed")
    field = "document.querySelector('form:not(.find) input[name=value]')"
    assert person.tab.run(f"{field}.max") == "1.0"
    person.type(field, "0.5")
    person.follow(f"{field}.form.querySelector('button')")
    assert "max_speed" in person.tab.run(NOTICE)
    assert person.clicks == 4


def test_to_see_the_battery_fall_below_a_fifth_takes_two_clicks(tab: Any, serve: Callable[..., Served]) -> None:
    person = Person(tab, serve("rover:?battery=0.201&rate=20").url)
    person.find("battery", "/battery_state")
    assert 0 < float(person.tab.until(person.reads("percentage"))) <= 1
    person.tab.until(f"Number({person.reads('percentage')}) < 0.2")
    assert person.clicks == 2
