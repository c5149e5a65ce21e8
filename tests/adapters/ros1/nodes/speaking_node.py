"""Publisher of messages at 20 Hz: speaking_node.py NODE (TOPIC TYPE VALUE)..., each value as YAML.

Prints each message in the format of `rostopic echo`: "says TOPIC JSON".
"""

import json
import sys

import genpy
import roslib.message
import rospy
import yaml

rospy.init_node(sys.argv[1])
spoken = []
for topic, type_name, value in zip(*[iter(sys.argv[2:])] * 3, strict=True):
    kind = roslib.message.get_message_class(type_name)
    message = kind()
    genpy.message.fill_message_args(message, [yaml.safe_load(value)])
    spoken.append((rospy.Publisher(topic, kind, queue_size=10), message))
    print("says", topic, json.dumps(yaml.safe_load(genpy.message.strify_message(message))), flush=True)
rate = rospy.Rate(20)
print("ready", flush=True)
while not rospy.is_shutdown():
    for publisher, message in spoken:
        publisher.publish(message)
    rate.sleep()
