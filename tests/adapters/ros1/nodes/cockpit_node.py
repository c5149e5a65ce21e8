"""The cockpit of the rospy aircraft, which prints the messages of /cockpit/display."""

import rospy
from std_msgs.msg import String

rospy.init_node("cockpit")
rospy.Subscriber(
    "/cockpit/display", String, lambda text: print(f"display {text.data}\n", end="", flush=True), queue_size=1000
)
print("ready", flush=True)
rospy.spin()
