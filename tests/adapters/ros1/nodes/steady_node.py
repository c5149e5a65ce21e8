"""Publisher without a queue, which prints the longest duration of a publish every half second.

    steady_node.py TOPIC [BYTES [RATE]]

A publisher with queue_size=None writes to its subscribers itself: one that does not read blocks it.
"""

import sys
import time
import warnings

import rospy
from std_msgs.msg import String

warnings.simplefilter("ignore")
rospy.init_node("steady")
publisher = rospy.Publisher(sys.argv[1], String, queue_size=None)
size, hertz = (*map(float, sys.argv[2:4]), *(100_000.0, 200.0)[len(sys.argv[2:4]) :])
text = String("x" * int(size))
rate = rospy.Rate(hertz)
print("ready", flush=True)
longest, told = 0.0, time.monotonic()
while not rospy.is_shutdown():
    began = time.monotonic()
    publisher.publish(text)
    longest = max(longest, time.monotonic() - began)
    if time.monotonic() - told > 0.5:
        print(f"longest {longest:.4f} {publisher.get_num_connections()}", flush=True)
        longest, told = 0.0, time.monotonic()
    rate.sleep()
