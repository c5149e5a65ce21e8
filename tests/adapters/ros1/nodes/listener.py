"""Subscriber that prints each message of a topic as one line of JSON: listener.py TOPIC TYPE."""

import json
import sys

import genpy
import roslib.message
import rospy
import yaml


def heard(message):
    value = yaml.safe_load(genpy.message.strify_message(message))
    print(f"heard {json.dumps(value)}\n", end="", flush=True)  # one write: a thread per publisher runs this


topic, type_name = sys.argv[1:3]
rospy.init_node("listener", anonymous=True)
rospy.Subscriber(topic, roslib.message.get_message_class(type_name), heard, queue_size=1000)
print("ready", flush=True)
rospy.spin()
