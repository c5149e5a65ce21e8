"""Publisher of one transform on /tf at 10 Hz, or latched on /tf_static: tf_node.py CHILD [static]."""

import sys

import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

child, is_static = sys.argv[1], "static" in sys.argv[2:]
rospy.init_node(f"tf_{child}")
publisher = rospy.Publisher("/tf_static" if is_static else "/tf", TFMessage, queue_size=10, latch=is_static)
transform = TransformStamped()
transform.header.frame_id = "map"
transform.child_frame_id = child
transform.transform.rotation.w = 1.0
rate = rospy.Rate(10)
print("ready", flush=True)
while not rospy.is_shutdown():
    transform.header.stamp = rospy.Time.now()
    publisher.publish(TFMessage([transform]))
    if is_static:
        rospy.spin()
    rate.sleep()
