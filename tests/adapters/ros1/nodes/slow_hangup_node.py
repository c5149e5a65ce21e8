"""A rospy listener that is slow to notice the end of a publisher's connection: `TOPIC SECONDS`."""

import sys
import time

import rospy
from rospy.impl.tcpros_base import TCPROSTransport
from std_msgs.msg import String

topic, seconds = sys.argv[1], float(sys.argv[2])
close = TCPROSTransport.close


def close_late(transport):
    """Close a connection after a delay, as on a busy machine."""
    if not transport.done and transport.name == topic:
        time.sleep(seconds)
    close(transport)


TCPROSTransport.close = close_late
rospy.init_node("slow", anonymous=True)
rospy.Subscriber(topic, String, lambda message: print(f"heard {message.data}\n", end="", flush=True))
print("ready", flush=True)
rospy.spin()
