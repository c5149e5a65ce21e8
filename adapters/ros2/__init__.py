"""ROS 2, spoken through the rclpy of the robot's own ROS, which is imported when a source asks for it."""

from rosld.adapters.ros2.adapter import Ros2Adapter, adapter

__all__ = ["Ros2Adapter", "adapter"]
