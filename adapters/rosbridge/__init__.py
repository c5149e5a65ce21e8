"""ROS 1 and ROS 2 behind a rosbridge server (protocol 2.0): everything goes over one WebSocket."""

from rosld.adapters.rosbridge.adapter import adapter as adapter

__all__ = ["adapter"]
