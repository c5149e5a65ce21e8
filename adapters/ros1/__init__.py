"""ROS 1, spoken natively: the Master API and TCPROS in asyncio, with no ROS on this side."""

from rosld.adapters.ros1.adapter import Ros1Adapter, adapter

__all__ = ["Ros1Adapter", "adapter"]
