"""Actions that end in every possible way: `/ways` as its goals request, `/simple` as a SimpleActionServer."""

import os
import threading
import time

import actionlib
import rospy
from actionlib.msg import TestAction, TestFeedback, TestResult

SUCCEED, ABORT, REJECT, UNTIL_CANCELED, PENDING, VANISH, SILENT, REJECT_LATE = 1, 2, 3, 4, 5, 6, 7, 8


def pursue(goal):
    wanted = goal.get_goal().goal
    if wanted == REJECT:
        goal.set_rejected(None, "the arm is folded")
    elif wanted == REJECT_LATE:
        time.sleep(0.05)
        server.publish_status()
        goal.set_rejected(None, "thought twice")
    elif wanted == PENDING:
        server.publish_status()
    elif wanted == VANISH:
        goal.set_accepted("on my way")
        threading.Timer(1.0, os._exit, (1,)).start()
    elif wanted == ABORT:
        goal.set_accepted("trying")
        goal.set_aborted(TestResult(13), "the gripper is jammed")
    elif wanted == UNTIL_CANCELED:
        goal.set_accepted("until you say stop")
        goal.publish_feedback(TestFeedback(7))
    else:
        goal.set_accepted("going")
        threading.Thread(target=succeed, args=(goal,), daemon=True).start()


def succeed(goal):
    for step in (1, 2, 3):
        goal.publish_feedback(TestFeedback(step))
        time.sleep(0.1)
    goal.set_succeeded(TestResult(42), "there")


def cancel(goal):
    def end():
        time.sleep(0.5)
        goal.set_canceled(TestResult(-1), "stopped")

    server.publish_status()
    threading.Thread(target=end, daemon=True).start()


def simply(goal):
    for step in range(goal.goal):
        if simple.is_preempt_requested():
            simple.set_preempted(TestResult(step), "preempted")
            return
        simple.publish_feedback(TestFeedback(step))
        time.sleep(0.1)
    simple.set_succeeded(TestResult(goal.goal), "counted")


rospy.init_node("action_node")
server = actionlib.ActionServer("/ways", TestAction, pursue, cancel, auto_start=False)
server.start()
simple = actionlib.SimpleActionServer("/simple", TestAction, simply, auto_start=False)
simple.start()
print("ready", flush=True)
rospy.spin()
