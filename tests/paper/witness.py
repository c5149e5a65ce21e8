"""A rospy node that looks at the robot for the tests: a line in names a service, a line out is the data it answers."""

import json
import sys

import rospy
import rosservice

rospy.init_node("witness")
print("ready", flush=True)
for line in sys.stdin:
    name = line.strip()
    answer = rospy.ServiceProxy(name, rosservice.get_service_class_by_name(name))()
    print(json.dumps(answer.data), flush=True)
