"""Dry runs on a real ROS 1: a rospy node hears nothing of any of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.rover.rovers import STANDSTILL, running
from tests.server.test_dry_runs import path_of, run_all_dry, stand_ins


def test_a_rospy_node_hears_nothing_of_a_dry_run_of_each_described_write(
    serve: Callable[..., Any], tmp_path: Path
) -> None:
    with running("rospy", serve, tmp_path) as rover:
        wheels = rover.system.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
        made = stand_ins(rover.http, "/navigate_to", "/dock")
        speed = rover.json("/parameters/rover/max_speed")
        answers = run_all_dry(rover.http, made)
        planned = {(method, path) for method, path, answer in answers if answer.status_code == 200}
        commands = {("PUT", "/topics/cmd_vel"), ("POST", "/topics/cmd_vel"), ("POST", "/services/set_lights")}
        assert commands | {("POST", "/actions/navigate_to"), ("PUT", "/parameters/rover/max_speed")} <= planned
        plan = rover.http.put("/topics/cmd_vel", params={"dry-run": "true"}, json={}).json()
        assert len(plan["steps"][0]["receivers"]) == 2, "the rover and the listener"
        turning = {**STANDSTILL, "angular": {"x": 0.0, "y": 0.0, "z": 0.125}}
        held = path_of(rover.http.post("/topics/cmd_vel", json=turning, params={"rate": 5}))
        assert json.loads(wheels.line("heard").removeprefix("heard ")) == turning, "the first that it hears"
        assert rover.http.delete(held).status_code == 204
        assert rover.json("/parameters/rover/max_speed") == speed
