"""Services that answer, fail and hang in various ways."""

import threading

import rospy
from std_srvs.srv import Empty, EmptyResponse, SetBool, SetBoolResponse, Trigger, TriggerResponse


def raises(_):
    raise ValueError("the gripper is jammed")


def refuses(_):
    raise rospy.ServiceException("not today")


def hangs(_):
    print("hanging\n", end="", flush=True)
    threading.Event().wait(60)


def vanishes(_):
    import os

    os._exit(1)


rospy.init_node("services_node")
rospy.Service("/works", Trigger, lambda _: TriggerResponse(True, "done"))
rospy.Service("/echoes", SetBool, lambda request: SetBoolResponse(request.data, f"you said {request.data}"))
rospy.Service("/does_nothing", Empty, lambda _: EmptyResponse())
rospy.Service("/raises", Trigger, raises)
rospy.Service("/refuses", Trigger, refuses)
rospy.Service("/hangs", Trigger, hangs)
rospy.Service("/vanishes", Trigger, vanishes)
print("ready", flush=True)
rospy.spin()
