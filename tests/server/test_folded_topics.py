"""Topics whose messages complement each other: the newest element of each key, from any message."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import until

FOLDED = {
    "tf2_msgs/msg/TFMessage": ("transforms", "child_frame_id"),
    "diagnostic_msgs/msg/DiagnosticArray": ("status", "name"),
}


def message(type: str, **values: float) -> dict[str, Any]:
    """Return a message with an element for each key, with this number."""
    array, key = FOLDED[type]
    if array == "transforms":
        return {array: [{key: name, "transform": {"translation": {"x": x}}} for name, x in values.items()]}
    return {array: [{key: name, "message": str(x)} for name, x in values.items()]}


def numbers(http: httpx.Client, type: str) -> list[tuple[str, float]]:
    """Return the elements of a read, in order."""
    array, key = FOLDED[type]
    found = http.get("/topics/folded", headers={"Accept": "application/json"}).json()
    elements = found[array] if found else []
    if array == "transforms":
        return [(one[key], one["transform"]["translation"]["x"]) for one in elements]
    return [(one[key], float(one["message"])) for one in elements]


def shown(http: httpx.Client, type: str, **values: float) -> None:
    """Wait until these elements are read, ordered by key."""
    until(lambda: numbers(http, type) == sorted(values.items()), f"{values}")


@pytest.mark.parametrize("type", FOLDED)
def test_the_newest_element_of_each_key_is_read(robot: MadeUp, serving: Serving, type: str) -> None:
    array, _ = FOLDED[type]
    twice = [*message(type, wheel=1.0)[array], *message(type, wheel=2.0)[array]]
    robot.topic("/folded", type, {array: twice})
    http = serving()
    assert numbers(http, type) == [("wheel", 2.0)]
    with http.stream("GET", "/topics/folded", headers={"Accept": "text/event-stream"}) as kept:
        assert kept.status_code == 200  # while a client follows, received elements are stored
        robot.publishes("/folded", message(type, arm=2.0))
        shown(http, type, arm=2.0, wheel=2.0)
        robot.publishes("/folded", message(type, arm=4.0, lid=5.0))
        shown(http, type, arm=4.0, lid=5.0, wheel=2.0)
    for x in range(6, 16):  # none is lost between two reads
        robot.publishes("/folded", message(type, **{f"joint{x}": float(x), "wheel": float(x)}))
    found = dict(numbers(http, type))
    assert found.items() >= ({f"joint{x}": float(x) for x in range(6, 16)} | {"wheel": 15.0}).items()
