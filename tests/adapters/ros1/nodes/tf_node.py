"""Publishes one transform on /tf, ten times a second: tf_node.py CHILD_FRAME."""

import sys

import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

child = sys.argv[1]
rospy.init_node(f"tf_{child}")
publisher = rospy.Publisher("/tf", TFMessage, queue_size=10)
transform = TransformStamped()
transform.header.frame_id = "map"
transform.child_frame_id = child
transform.transform.rotation.w = 1.0
rate = rospy.Rate(10)
print("ready", flush=True)
while not rospy.is_shutdown():
    transform.header.stamp = rospy.Time.now()
    publisher.publish(TFMessage([transform]))
    rate.sleep()
