"""An action whose feedback and result are arrays: `/fibonacci` of actionlib's tutorials, which Debian lacks."""

import time

import actionlib
import rospy
from genpy.dynamic import generate_dynamic

PARTS = {"Goal": "int32 order", "Result": "int32[] sequence", "Feedback": "int32[] sequence"}
KNOWN = {
    "std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id",
    "actionlib_msgs/GoalID": "time stamp\nstring id",
    "actionlib_msgs/GoalStatus": "GoalID goal_id\nuint8 status\nstring text",
}
WRAPPED = {
    "Goal": "Header header\nactionlib_msgs/GoalID goal_id\nFibonacciGoal goal",
    "Result": "Header header\nactionlib_msgs/GoalStatus status\nFibonacciResult result",
    "Feedback": "Header header\nactionlib_msgs/GoalStatus status\nFibonacciFeedback feedback",
}
NAMES = {f"action_{part.lower()}": f"FibonacciAction{part}" for part in WRAPPED}
WHOLE = "\n".join(f"{name} {field}" for field, name in NAMES.items())


def texts():
    own = {f"actionlib_tutorials/Fibonacci{part}": text for part, text in PARTS.items()}
    wrapped = {f"actionlib_tutorials/FibonacciAction{part}": text for part, text in WRAPPED.items()}
    return {**KNOWN, **own, **wrapped}


def classes():
    """Return the class of the action, from its text and those of all nested types."""
    nested = [f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in texts().items()]
    return generate_dynamic("actionlib_tutorials/FibonacciAction", "\n".join([WHOLE, *nested]) + "\n")


made = classes()
action = made["actionlib_tutorials/FibonacciAction"]
result, feedback = made["actionlib_tutorials/FibonacciResult"], made["actionlib_tutorials/FibonacciFeedback"]


def count(goal):
    sequence = [0, 1]
    while len(sequence) < goal.order:
        sequence.append(sequence[-1] + sequence[-2])
        server.publish_feedback(feedback(list(sequence)))
        time.sleep(0.1)
    server.set_succeeded(result(sequence), "counted")


rospy.init_node("fibonacci")
server = actionlib.SimpleActionServer("/fibonacci", action, count, auto_start=False)
server.start()
print("ready", flush=True)
rospy.spin()
