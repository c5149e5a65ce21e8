"""Accessibility of pages according to axe, in a real browser."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.agents.node import node_modules

pytestmark = pytest.mark.slow

PAGES = (
    "", "topics/", "topics/scan", "topics/cmd_vel", "topics/camera/image_raw", "nodes/rover", "services/set_lights",
    "actions/navigate_to", "parameters/", "resources/rover/", "types/nav_msgs/msg/Odometry", "data/",
    "queries/silent-topics", "sparql", "bags/history/", "graph", "diagnostics", "space?view=3d", "frames",
    "cockpit/default", "plot?y=topics/odom%23twist.twist.linear.x", "find?q=speed", "ontology", "topics/none",
)  # fmt: skip
"""The rover's pages, one of each kind."""
ON_A_PHONE = ("topics/cmd_vel", "sparql", "space", "cockpit/default", "stop")
JUDGE = """axe.run(document, {resultTypes: ["violations"], iframes: false}).then((found) => found.violations
  .filter((each) => ["serious", "critical"].includes(each.impact))
  .flatMap((each) => each.nodes.slice(0, 3).map((node) => `${each.id}: ${node.html.slice(0, 200)} ${
    node.any.concat(node.all).map((check) => check.message).join("; ").slice(0, 200)}`)))"""


@pytest.mark.parametrize(("pages", "width", "scheme"), [(PAGES, 1400, "light"), (ON_A_PHONE, 390, "dark")])
def test_axe_finds_nothing_serious(
    tab: Any, rover: httpx.Client, pages: tuple[str, ...], width: int, scheme: str
) -> None:
    axe = (node_modules() / "axe-core" / "axe.min.js").read_text()
    tab.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    tab.send("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
    found = {}
    for path in pages:
        tab.open(f"{rover.base_url}{path}")
        tab.run(f"{axe}; 0")
        if wrong := tab.run(JUDGE):
            found[path] = wrong
    assert not found, "\n".join(f"{path}: {each}" for path, wrong in found.items() for each in wrong)
