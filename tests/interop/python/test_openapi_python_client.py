"""openapi-python-client generates a client from `/openapi.json` whose functions and types read and drive a robot."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("openapi_python_client", reason="openapi-python-client is missing: pip install '.[interop]'")


PACKAGE = "rover_client"
JSON = {"Accept": "application/json"}


def test_a_client_that_it_makes_reads_a_message_and_plans_a_command_by_their_types(
    start_server: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = start_server("rover")
    description, made = tmp_path / "openapi.json", tmp_path / "made"
    description.write_bytes(served.http.get("openapi.json").content)
    config = tmp_path / "config.json"
    config.write_text(json.dumps({"package_name_override": PACKAGE, "post_hooks": []}))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--path", str(description)]
    command += ["--output-path", str(made), "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    monkeypatch.syspath_prepend(str(made))
    client = importlib.import_module(PACKAGE).Client(served.url, headers=JSON)
    battery = importlib.import_module(f"{PACKAGE}.api.topics.get_topics_battery_state").sync(client=client)
    assert type(battery).__name__ == "SensorMsgsMsgBatteryState"
    assert 0 < battery.voltage < 20
    twist = importlib.import_module(f"{PACKAGE}.models.geometry_msgs_msg_twist_sent").GeometryMsgsMsgTwistSent
    put = importlib.import_module(f"{PACKAGE}.api.topics.put_topics_cmd_vel")
    planned = put.sync_detailed(client=client, body=twist.from_dict({"linear": {"x": 0.1}}), dry_run=True)
    assert json.loads(planned.content)["dryRun"] is True
    speed = importlib.import_module(f"{PACKAGE}.api.parameters.get_parameters_rover_max_speed")
    assert speed.sync(client=client) == served.http.get("parameters/rover/max_speed", headers=JSON).json()
