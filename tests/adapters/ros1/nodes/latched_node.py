"""Publisher of one latched string: latched_node.py NODE TOPIC TEXT."""

import sys

import rospy
from std_msgs.msg import String

node, topic, text = sys.argv[1:4]
rospy.init_node(node)
publisher = rospy.Publisher(topic, String, queue_size=1, latch=True)
publisher.publish(text)
print("ready", flush=True)
rospy.spin()
