"""The pages of containers for people: what they count is what there is."""

from __future__ import annotations

import re

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, Serving

HTML = {"Accept": "text/html"}


def counted(http: httpx.Client, path: str) -> tuple[int, int]:
    """The number that the page of a container names, and the rows of its table."""
    page = http.get(path, headers=HTML).text
    found = re.search(r'Contains <span class="count">([\d,]+)</span>', page)
    assert found
    return int(found[1].replace(",", "")), page.count('<tr data-key="')


def filled(robot: MadeUp, per_namespace: int) -> None:
    """Topics in 51 namespaces."""
    names = [f"/n{namespace}/t{number}" for namespace in range(51) for number in range(per_namespace)]
    robot.topics(names, "geometry_msgs/msg/Vector3")


@pytest.mark.parametrize("per_namespace", [7, 30])
def test_a_listing_counts_every_name_and_not_the_namespaces_that_they_are_in(
    robot: MadeUp, serving: Serving, per_namespace: int
) -> None:
    others = len(robot.graph.topics)
    filled(robot, per_namespace)
    http = serving()
    total, shown = counted(http, "/topics/")
    assert total == others + 51 * per_namespace
    assert shown == min(total, 1000)
    assert ("The first 1,000 are shown" in http.get("/topics/", headers=HTML).text) == (total > 1000)


def test_what_a_container_of_data_counts_are_its_members(robot: MadeUp, serving: Serving) -> None:
    http = serving()
    for name in ("a", "b/", "c"):
        assert http.put(f"/data/{name}", content="", headers={"Content-Type": "text/turtle"}).status_code == 201
    assert counted(http, "/data/")[0] == 3
