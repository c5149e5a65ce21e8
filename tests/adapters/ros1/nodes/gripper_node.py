"""A topic of a type without a package, which nests another type of that kind: `/grip` of gripper_own/Grip."""

import rospy
from genpy.dynamic import generate_dynamic

TEXT = "\n".join(["Tip left", "Tip right", "=" * 80, "MSG: gripper_own/Tip", "# in newtons", "float64 force", ""])
grip = generate_dynamic("gripper_own/Grip", TEXT)["gripper_own/Grip"]

rospy.init_node("gripper")
publisher = rospy.Publisher("/grip", grip, queue_size=1, latch=True)
publisher.publish(grip())
print("ready", flush=True)
rospy.spin()
