"""Publisher of one transform on /tf_static, transient local: static_frame.py CHILD."""

from __future__ import annotations

import sys

from geometry_msgs.msg import TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from running import begun, run
from tf2_msgs.msg import TFMessage

child = sys.argv[1]
context = begun()
node = Node(f"tf_{child}", context=context)
kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
transform = TransformStamped(child_frame_id=child)
transform.header.frame_id = "base_link"
publisher = node.create_publisher(TFMessage, "/tf_static", kept)
publisher.publish(TFMessage(transforms=[transform]))
run(context, SingleThreadedExecutor(context=context), [node])
