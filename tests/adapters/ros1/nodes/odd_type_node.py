"""Publisher of a topic whose definition is invalid, like a node with a broken message package."""

import rospy
from std_msgs.msg import String


class Odd(String):
    _type = "odd_msgs/Odd"
    _md5sum = "00000000000000000000000000000000"
    _full_text = "nowhere_msgs/Missing what\n"


rospy.init_node("odd_type")
publisher = rospy.Publisher("/odd", Odd, queue_size=1, latch=True)
publisher.publish(Odd("?"))
print("ready", flush=True)
rospy.spin()
