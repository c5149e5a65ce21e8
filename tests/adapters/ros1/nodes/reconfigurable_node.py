"""A node with two servers of dynamic_reconfigure, `/arm` and `/arm/gripper`, and a parameter read only at start.

The configuration of `/arm` is published as JSON on `/arm/state`. Its speed has steps of a quarter, and a mode of 3 is
refused.
"""

import json
import sys
from types import SimpleNamespace

import rospy
from dynamic_reconfigure.parameter_generator_catkin import ParameterGenerator
from dynamic_reconfigure.server import Server
from std_msgs.msg import String

sys.argv[1:] = ["", "", "", ""]  # the generator requires the folders that it would write files to
INFINITE = float("inf")


def config_of(generator):
    """Return the module that dynamic_reconfigure generates from a .cfg."""
    description = generator.group.to_dict()

    def members(group):
        return [*group["parameters"], *(each for inner in group["groups"] for each in members(inner))]

    found = {end: {each["name"]: each[end] for each in members(description)} for end in ("min", "max", "default")}
    return SimpleNamespace(
        config_description=description, min=found["min"], max=found["max"], defaults=found["default"], level={}
    )


def arm():
    generator = ParameterGenerator()
    modes = [
        generator.const("Slow", "int", 0, "For people nearby"),
        generator.const("Fast", "int", 1, ""),
        generator.const("Broken", "int", 3, "Never"),
    ]
    tools = [generator.const("Gripper", "str", "gripper", "Two fingers"), generator.const("Cup", "str", "cup", "")]
    generator.add("speed", "double", 1, "How fast it moves, in rad/s.", 0.5, 0.0, 2.0)
    generator.add("offset", "double", 1, "", 0.0, -INFINITE, INFINITE)
    generator.add("joints", "int", 1, "How many joints it uses.", 6, 1, 7)
    generator.add("mode", "int", 2, "How it moves", 0, 0, 3, edit_method=generator.enum(modes, "The modes"))
    generator.add("tool", "str", 2, "What it holds", "cup", edit_method=generator.enum(tools, "The tools"))
    generator.add("label", "str", 2, "What it is called, such as ü", "an arm")
    inner = generator.add_group("Inner")
    inner.add("enabled", "bool", 4, "Whether it moves at all.", True)
    return config_of(generator)


def gripper():
    generator = ParameterGenerator()
    generator.add("force", "int", 1, "In newtons.", 10, 0, 50)
    return config_of(generator)


def moved(config, level):
    if config["mode"] == 3:
        raise ValueError("this mode is broken")
    config["speed"] = round(config["speed"] * 4) / 4
    state.publish(json.dumps({name: config[name] for name in ("speed", "joints", "mode", "tool", "enabled")}))
    return config


rospy.init_node("arm")
rospy.set_param("~frame", "base")
state = rospy.Publisher("~state", String, latch=True, queue_size=1)
server = Server(arm(), moved)
Server(gripper(), lambda config, level: config, namespace="gripper")


def heard(message):
    """Adjust the configuration as the node decides."""
    server.update_configuration(json.loads(message.data))


rospy.Subscriber("~decide", String, heard)
print("ready", flush=True)
rospy.spin()
