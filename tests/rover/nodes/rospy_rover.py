"""The rover as a rospy node, `/rover`: the simulation that rosld embeds, connected to a real ROS 1.

    rospy_rover.py [rover:?battery=0.21&rate=10]

It continues with the last command, as the embedded one does. Its parameters are dynamic_reconfigure's, except
`wheel_separation`, which is read-only. Prints "ready".
"""

import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import actionlib
import rospy
from dynamic_reconfigure.parameter_generator_catkin import ParameterGenerator
from dynamic_reconfigure.server import Server
from genpy.dynamic import generate_dynamic
from roslib.message import get_message_class
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse

from rosld.adapters.model import GoalStatus
from rosld.adapters.rover.graph import (
    ACTIONS,
    CMD_VEL,
    DOCK,
    LATCHED,
    LIGHTS,
    NAVIGATE_TO,
    PERIODIC,
    SET_LIGHTS,
    TOPICS,
)
from rosld.adapters.rover.messages import View, navigation_feedback, navigation_result
from rosld.adapters.rover.navigation import Declined, goal_of, velocity_of
from rosld.adapters.rover.settings import DEFAULTS, PARAMETERS
from rosld.adapters.rover.simulation import Severity, Simulation, read_source

PERIOD = 0.05
FEEDBACK_PERIOD = 0.2
PARTS = ("Goal", "Result", "Feedback")
DEFINITIONS = Path(__file__).resolve().parents[3] / "adapters" / "model" / "definitions"
SHARE = Path("/usr/share")
TYPES = {bool: "bool", int: "int", float: "double", str: "str"}
LOG = {Severity.INFO: rospy.loginfo, Severity.WARN: rospy.logwarn, Severity.ERROR: rospy.logerr}


# Messages


def class_of(name):
    """Return the class of a type by its name in ROS 2."""
    return get_message_class(name.replace("/msg/", "/"))


def fill(made, fields):
    """Return a message of ROS 1 with its fields from ROS 2, some of which are capitalized."""
    types = dict(zip(made.__slots__, made._slot_types, strict=True))
    for name, value in fields.items():
        slot = name if name in types else name.upper()
        if slot in types:
            setattr(made, slot, convert(types[slot], getattr(made, slot), value))
    return made


def convert(type, empty, value):
    """Return a value of a message converted to the type of a field with this empty value."""
    if type == "time":
        return rospy.Time(value["sec"], value["nanosec"])
    if isinstance(value, dict):
        return fill(empty, value)
    if type == "uint8[]":
        return value.tobytes()
    if isinstance(value, list):
        return [fill(get_message_class(type[:-2])(), each) for each in value]
    return value.tolist() if hasattr(value, "tolist") else value


# The action, whose messages Debian has no generator for


def action_messages(name):
    """Return the definitions of the messages in which actionlib wraps the parts of an action."""
    status = "Header header\nactionlib_msgs/GoalStatus status\n"
    return {
        "ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal",
        "ActionResult": f"{status}{name}Result result",
        "ActionFeedback": f"{status}{name}Feedback feedback",
    }


def action_classes(type):
    """Return the classes of an action, by the suffix of their names: `Goal`, `Action`, `ActionGoal`, ..."""
    package, _, name = type.split("/")
    thirds = (DEFINITIONS / package / "action" / f"{name}.action").read_text().split("\n---\n")
    texts = {f"{package}/{name}{part}": text for part, text in zip(PARTS, thirds, strict=True)}
    texts.update({f"{package}/{name}{part}": text for part, text in action_messages(name).items()})
    for other in ("actionlib_msgs/GoalID", "actionlib_msgs/GoalStatus", "std_msgs/Header", "geometry_msgs/PoseStamped"):
        texts[other] = installed(other)
    for other in ("geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"):
        texts[other] = installed(other)
    fields = "\n".join(f"{name}Action{part} action_{part.lower()}" for part in PARTS)
    nested = [f"{'=' * 80}\nMSG: {each}\n{text}" for each, text in texts.items()]
    made = generate_dynamic(f"{package}/{name}Action", "\n".join([fields, *nested]) + "\n")
    return {each.partition(f"/{name}")[2]: kind for each, kind in made.items() if f"/{name}" in each}


def installed(type):
    package, name = type.split("/")
    return (SHARE / package / "msg" / f"{name}.msg").read_text()


# Parameters


def enumeration(generator, name, declared):
    """Return dynamic_reconfigure's notation of the allowed values of a parameter."""
    if declared.choices is None:
        return ""
    constants = [generator.const(value, "str", value, words) for value, words in declared.choices.items()]
    return generator.enum(constants, f"The values of {name}")


def config_type():
    """Return the module that dynamic_reconfigure generates from a .cfg, for the writable parameters."""
    sys.argv[1:] = ["", "", "", ""]  # it requires the folders that it would write files to
    generator = ParameterGenerator()
    for name, declared in PARAMETERS.items():
        if not declared.is_read_only:
            how = enumeration(generator, name, declared)
            kind = TYPES[type(declared.default)]
            given = (declared.default, declared.least, declared.greatest)
            generator.add(name, kind, 0, declared.description, *given, edit_method=how)
    description = generator.group.to_dict()
    for each in description["parameters"]:
        if each["type"] == "double":
            each.update({end: float(each[end]) for end in ("min", "max", "default")})
    found = {end: {each["name"]: each[end] for each in description["parameters"]} for end in ("min", "max", "default")}
    return SimpleNamespace(
        config_description=description, min=found["min"], max=found["max"], defaults=found["default"], level={}
    )


# The node


class Rover:
    def __init__(self, start):
        self.lock = threading.RLock()
        self.simulation = Simulation(start, time.monotonic())
        self.values = dict(DEFAULTS)
        self.due = {}
        self.goals = {}
        classes = action_classes(ACTIONS[NAVIGATE_TO])
        self.result, self.feedback = classes["Result"], classes["Feedback"]
        self.publishers = {
            name: rospy.Publisher(name, class_of(each.type), queue_size=5, latch=name in LATCHED)
            for name, each in {**PERIODIC, **LATCHED}.items()
        }
        for name in LATCHED:
            self.say(name, LATCHED[name])
        rospy.set_param("~wheel_separation", DEFAULTS["wheel_separation"])
        self.server = Server(config_type(), self.configure)
        rospy.Subscriber(CMD_VEL, class_of(TOPICS[CMD_VEL]), self.command, queue_size=10)
        rospy.Service(SET_LIGHTS, SetBool, self.switch_lights)
        rospy.Service(DOCK, Trigger, self.dock)
        self.actions = actionlib.ActionServer(NAVIGATE_TO, classes["Action"], self.navigate, self.cancel, False)
        self.actions.start()

    def command(self, twist):
        with self.lock:
            self.simulation.command(velocity_of(twist), time.monotonic())

    def switch_lights(self, request):
        with self.lock:
            answer = self.simulation.switch_lights(request.data, time.monotonic())
            self.say(LIGHTS, LATCHED[LIGHTS])
        return SetBoolResponse(*answer)

    def dock(self, _):
        with self.lock:
            return TriggerResponse(*self.simulation.dock(time.monotonic()))

    def configure(self, config, _level):
        """Accept valid values: dynamic_reconfigure limits numbers to their ranges, but does not check enumerations."""
        with self.lock:
            if config["drive_mode"] not in PARAMETERS["drive_mode"].choices:
                config["drive_mode"] = self.values["drive_mode"]
            self.values.update({name: config[name] for name in self.values if name in config})
            self.simulation.configure(self.values, time.monotonic())
        return config

    def navigate(self, handle):
        with self.lock:
            try:
                goal = goal_of(handle.get_goal())
            except Declined as declined:
                handle.set_rejected(None, str(declined))
                return
            id = handle.get_goal_id().id
            self.goals[id] = handle
            handle.set_accepted("on the way")
            self.simulation.navigate(id, goal, time.monotonic())

    def cancel(self, handle):
        with self.lock:
            self.simulation.cancel(handle.get_goal_id().id, time.monotonic())

    def tick(self):
        with self.actions.lock, self.lock:  # in the order in which the action server calls `navigate` and `cancel`
            now = time.monotonic()
            self.simulation.advance(now)
            for name, each in PERIODIC.items():
                if now >= self.due.get(name, now) and self.publishers[name].get_num_connections():
                    self.say(name, each)
                    self.due[name] = max(self.due.get(name, now), now - PERIOD) + each.period(self.simulation.settings)
            self.tell_of_goals(now)
            for line in self.simulation.take_log():
                LOG[line.severity](line.text)

    def tell_of_goals(self, now):
        motion, journey, time_ns = self.simulation.state.motion, self.simulation.state.journey, time.time_ns()
        for ended in self.simulation.take_ended():
            handle = self.goals.pop(ended.id)
            result = fill(self.result(), navigation_result(ended, motion, time_ns))
            ways = {GoalStatus.SUCCEEDED: handle.set_succeeded, GoalStatus.ABORTED: handle.set_aborted}
            ways.get(ended.outcome, handle.set_canceled)(result, ended.message)
        if journey is not None and now >= self.due.get(NAVIGATE_TO, now):
            self.due[NAVIGATE_TO] = now + FEEDBACK_PERIOD
            feedback = navigation_feedback(journey, motion, time_ns)
            self.goals[journey.id].publish_feedback(fill(self.feedback(), feedback))

    def say(self, name, each):
        simulation = self.simulation
        view = View(simulation.state, simulation.settings, simulation.world, time.time_ns())
        self.publishers[name].publish(fill(class_of(each.type)(), each.compose(view)))


def main():
    start = read_source(sys.argv[1] if len(sys.argv) > 1 else "rover")
    rospy.init_node("rover")
    rover = Rover(start)
    print("ready", flush=True)
    while not rospy.is_shutdown():
        rover.tick()
        time.sleep(PERIOD)


main()
