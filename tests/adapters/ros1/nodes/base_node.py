"""A base without a watchdog: base_node.py [TOPIC]. It drives on at the last speed that it was told.

Prints "drive X MOMENT" for each command, X being how fast ahead and MOMENT the seconds of the clock that never jumps.
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
