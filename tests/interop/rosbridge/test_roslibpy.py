"""roslibpy as a client of the rosbridge server of the tests, on which the tests of the adapter rely."""

from __future__ import annotations

import importlib.util
from typing import Any

from rosld.adapters.base import AdapterOptions
from rosld.adapters.rover import rover_adapter
from tests.adapters.rosbridge.bridge import Bridge
from tests.interop.missing import missing
from tests.waiting import until


def test_roslibpy_finds_reads_publishes_and_calls_through_the_bridge_of_the_tests() -> None:
    if importlib.util.find_spec("roslibpy") is None:
        missing("there is no roslibpy: pip install '.[interop]'")
    import roslibpy

    bridge = Bridge(lambda: rover_adapter("rover", AdapterOptions()))
    bridge.start()
    client = roslibpy.Ros("127.0.0.1", bridge.port)
    received: list[Any] = []
    try:
        client.run(20)
        assert {"/odom", "/cmd_vel"} <= set(client.get_topics())
        assert client.get_topic_type("/odom") == "nav_msgs/msg/Odometry"
        assert "/rover" in client.get_nodes()
        roslibpy.Topic(client, "/odom", "nav_msgs/msg/Odometry").subscribe(received.append)
        until(lambda: received, "a message of /odom", 20)
        assert received[0]["child_frame_id"] == "base_link"
        lights = roslibpy.Service(client, "/set_lights", "std_srvs/srv/SetBool")
        assert lights.call(roslibpy.ServiceRequest({"data": True}), timeout=20)["message"] == "the lights are on"
        velocity = roslibpy.Topic(client, "/cmd_vel", "geometry_msgs/msg/Twist")
        velocity.advertise()
        velocity.publish(roslibpy.Message({"linear": {"x": 0.2}}))
        until(lambda: any(each["twist"]["twist"]["linear"]["x"] > 0.01 for each in received), "the rover moves", 20)
    finally:
        client.close()
        bridge.stop()
