"""Topics whose messages complement each other: the newest element of each key, from any message."""

from __future__ import annotations

from typing import Any

import httpx

from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import until


def message(**values: float) -> dict[str, Any]:
    """Return a message with a transform of each of these frames."""
    return {
        "transforms": [{"child_frame_id": name, "transform": {"translation": {"x": x}}} for name, x in values.items()]
    }


def numbers(http: httpx.Client) -> list[tuple[str, float]]:
    """Return the elements of a read, in order."""
    found = http.get("/topics/folded", headers={"Accept": "application/json"}).json()
    elements = found["transforms"] if found else []
    return [(one["child_frame_id"], one["transform"]["translation"]["x"]) for one in elements]


def shown(http: httpx.Client, **values: float) -> None:
    """Wait until these elements are read, ordered by key."""
    until(lambda: numbers(http) == sorted(values.items()), f"{values}")


def test_the_newest_element_of_each_key_is_read(robot: MadeUp, serving: Serving) -> None:
    twice = [*message(wheel=1.0)["transforms"], *message(wheel=2.0)["transforms"]]
    robot.topic("/folded", "tf2_msgs/msg/TFMessage", {"transforms": twice})
    http = serving()
    assert numbers(http) == [("wheel", 2.0)]
    with http.stream("GET", "/topics/folded", headers={"Accept": "text/event-stream"}) as kept:
        assert kept.status_code == 200  # while a client follows, received elements are stored
        robot.publishes("/folded", message(arm=2.0))
        shown(http, arm=2.0, wheel=2.0)
        robot.publishes("/folded", message(arm=4.0, lid=5.0))
        shown(http, arm=4.0, lid=5.0, wheel=2.0)
    for x in range(6, 16):  # none is lost between two reads
        robot.publishes("/folded", message(**{f"joint{x}": float(x), "wheel": float(x)}))
    found = dict(numbers(http))
    assert found.items() >= ({f"joint{x}": float(x) for x in range(6, 16)} | {"wheel": 15.0}).items()
