"""A base without a watchdog: base_node.py [TOPIC]. It continues at the last speed that it received.

Prints "drive X TIME" for each command, where X is the forward speed and TIME the seconds of the monotonic clock.
"""

import sys
import time

import rospy
from geometry_msgs.msg import Twist


def drive(command):
    print(f"drive {command.linear.x:g} {time.monotonic():.6f}\n", end="", flush=True)


rospy.init_node("base")
rospy.Subscriber(sys.argv[1] if len(sys.argv) > 1 else "/cmd_vel", Twist, drive, queue_size=1000)
print("ready", flush=True)
rospy.spin()
