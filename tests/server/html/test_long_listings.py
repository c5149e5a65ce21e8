"""Pages of hundreds of members: at most three screens, folded by namespace, filtered while the user types."""

from __future__ import annotations

import re
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.html.labels import MAX_ROWS, group_names
from tests.server.robots.made_up import MadeUp, Serving, robot, serving
from tests.server.robots.many import COUNT, furnish

__all__ = ["robot", "serving"]

WIDTH, SCREEN = 1400, 900
TALL = "document.documentElement.scrollHeight"
SHOWN = "[...document.querySelectorAll('details.group tbody tr')].filter((each) => each.checkVisibility())"
NAMES = st.lists(st.text("ab/", min_size=1, max_size=6), max_size=200)


@given(NAMES)
def test_groups_hold_every_item_once_in_a_bounded_number(names: list[str]) -> None:
    groups = group_names(names, str)
    if len(names) <= MAX_ROWS:
        assert groups == ()
        return
    assert sorted(item for group in groups for item in group.items) == sorted(names)
    assert len(groups) <= 80
    assert all(group.items for group in groups)


def test_names_in_no_namespace_come_first_in_parts_of_one_size() -> None:
    names = [f"x{number:03}" for number in range(100)] + ["arm/a", "arm/b", "leg/a"]
    groups = group_names(names, str)
    assert [(group.title, len(group.items)) for group in groups] == [
        ("x000 … x033", 34), ("x034 … x067", 34), ("x068 … x099", 32), ("arm/", 2), ("leg/", 1),
    ]  # fmt: skip
    assert not any(group.is_open for group in groups)


def test_of_very_many_namespaces_several_are_one_group_and_few_names_are_unfolded() -> None:
    names = ["odom", *(f"robot{number:03}/pose" for number in range(400))]
    first, *others = group_names(names, str)
    assert (first.items, first.is_open) == (("odom",), True)
    assert (len(others), others[0].title, len(others[0].items)) == (40, "robot000/ … robot009/", 10)


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    """A robot with 330 topics and 60 services, all topics subscribed to."""
    furnish(robot)
    for number in range(60):
        robot.offer(f"/service_{number:02}/do", "std_srvs/srv/Trigger", lambda _: {"success": True})
    client = serving(subscribe=("/*",))
    client.timeout = 60
    return client


def tall(tab: Any, http: httpx.Client, *paths: str) -> list[str]:
    """Return the pages higher than three screens."""
    tab.send("Emulation.setDeviceMetricsOverride", width=WIDTH, height=SCREEN, deviceScaleFactor=1, mobile=False)
    found = []
    for path in paths:
        tab.open(f"{http.base_url}{path}")
        if tab.run(TALL) > 3 * SCREEN:
            found.append(path)
    return found


@pytest.mark.slow
def test_pages_of_hundreds_are_three_screens_at_most_and_filtered_by_typing_while_values_go_on(
    tab: Any, robot: MadeUp, http: httpx.Client
) -> None:
    paths = ("services/", "resources/", "nodes/robot", "types/", "topics/")
    assert tall(tab, http, *paths) == []
    tab.until("document.querySelector('.liveness').dataset.state === 'live'")
    assert tab.run(f"{SHOWN}.length") == 0
    tab.run("document.querySelector('.filter input').focus()")
    tab.type("battery_2 state")
    tab.until(f"{SHOWN}.length === 1")
    robot.publishes("/battery_2/state", {"percentage": 0.25, "voltage": 11.5})
    tab.until(f"{SHOWN}[0].textContent.includes('voltage 11.5')")  # the page was replaced, and remains filtered
    assert tab.run(f"{SHOWN}.length") == 1
    assert tab.run("document.querySelector('.filter').checkVisibility()")
    tab.run("document.querySelector('.filter input').select()")
    tab.type("no such topic")
    tab.until(f"{SHOWN}.length === 0")
    groups = "[...document.querySelectorAll('details.group')]"
    assert tab.run(f"{groups}.filter((each) => each.checkVisibility()).length") == 0
    page = http.get("/topics/", headers={"Accept": "text/html"}).text
    keys = re.findall(r'<tr data-key="([^"]+)"', page)
    assert (len(keys), len(set(keys))) == (COUNT, COUNT), "all rows are there without scripts"
    assert '<p class="filter" hidden>' in page
