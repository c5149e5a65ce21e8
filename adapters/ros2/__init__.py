"""ROS 2 through the rclpy of the robot's own ROS installation, which is imported when a source needs it."""

from rosld.adapters.ros2.adapter import Ros2Adapter, adapter

__all__ = ["Ros2Adapter", "adapter"]
