"""Subscriber that prints the size of the map and the static frames on receipt."""

import rospy
from nav_msgs.msg import OccupancyGrid
from tf2_msgs.msg import TFMessage


def frames(message):
    for transform in message.transforms:
        print(f"frame {transform.child_frame_id}\n", end="", flush=True)  # one write: each topic has its thread


rospy.init_node("late")
print("ready", flush=True)
rospy.Subscriber("/map", OccupancyGrid, lambda message: print(f"map {len(message.data)}\n", end="", flush=True))
rospy.Subscriber("/tf_static", TFMessage, frames)
rospy.spin()
