"""Goals of another client: a SimpleActionClient of the action in the first argument, which sends the second."""

import sys

import actionlib
import rospy
from actionlib.msg import TestAction, TestGoal

rospy.init_node("action_client")
client = actionlib.SimpleActionClient(sys.argv[1], TestAction)
client.wait_for_server()
print("ready", flush=True)
client.send_goal(TestGoal(int(sys.argv[2])), active_cb=lambda: print("active\n", end="", flush=True))
client.wait_for_result()
print("done", client.get_state(), client.get_result().result, flush=True)
