"""ROS 1 without ROS on this side: a client of the Master API and TCPROS in asyncio."""

from rosld.adapters.ros1.adapter import Ros1Adapter, adapter

__all__ = ["Ros1Adapter", "adapter"]
