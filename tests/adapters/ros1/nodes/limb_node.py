"""A limb: getters that are counted, and that hang, raise, vanish and come back as they are told.

    limb_node.py FOLDER_OF_GENERATED_CLASSES FOLDER_OF_DEFINITIONS

What it is told comes by the service /limb_control/tell (a SetWords: `hang grip`); /limb_control/count (a GetWords) says
how often each service was called, as JSON.
"""

import json
import os
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path

import rospy
from nav_msgs.srv import GetMap, GetMapResponse
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Empty, EmptyResponse, SetBool, SetBoolResponse, Trigger, TriggerResponse


def generate(folder, definitions):
    """Make the Python package limb_msgs in a folder."""
    services = folder / "limb_msgs" / "srv"
    services.mkdir(parents=True)
    sources = sorted(map(str, definitions.glob("*.srv")))
    subprocess.run(
        ["/usr/bin/python3", "/usr/lib/genpy/gensrv_py.py", "-p", "limb_msgs", "-o", str(services), *sources],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    (services / "__init__.py").write_text("".join(f"from ._{Path(each).stem} import *\n" for each in sources))
    (folder / "limb_msgs" / "__init__.py").write_text("")
    sys.path.insert(0, str(folder))


generate(Path(sys.argv[1]), Path(sys.argv[2]) / "limb_msgs" / "srv")

from limb_msgs.srv import (  # noqa: E402
    GetByte,
    GetByteResponse,
    GetRange,
    GetRangeResponse,
    GetWords,
    GetWordsResponse,
    SetByte,
    SetByteResponse,
    SetRange,
    SetRangeResponse,
    SetWords,
    SetWordsResponse,
)

count = Counter()
offered = {}
free = threading.Event()
free.set()
raising = set()
values = {"grip": 1, "mode": "manual", "span": (0.5, 2.0)}


def offer(name, kind, act):
    """A service whose calls are counted, and wait while it hangs."""

    def answer(request):
        count[name] += 1
        free.wait(60)
        if name in raising:
            raise ValueError("the limb is <asleep>")
        return act(request)

    offered[name] = rospy.Service(name, kind, answer)


def set_grip(request):
    if request.value < 0:
        return SetByteResponse(False, "a grip is not negative")
    if request.value > 100:
        raise ValueError("it would break")
    values["grip"] = request.value
    return SetByteResponse(True, "")


def set_mode(request):
    values["mode"] = request.words
    return SetWordsResponse(True, "")


def set_span(request):
    values["span"] = (request.low, request.high)
    return SetRangeResponse()


def set_awake(request):
    awake.publish(request.data)
    return SetBoolResponse(True, "")


def offer_grip():
    offer("/limb/get_grip", GetByte, lambda _: GetByteResponse(values["grip"]))


def offer_arm():
    offer("/arm/get_grip", GetByte, lambda _: GetByteResponse(7))
    offer("/arm/home", Trigger, lambda _: TriggerResponse(True, ""))


def vanish():
    offered["/limb/get_grip"].shutdown("it was told to")


def tell(request):
    {
        "hang": free.clear,
        "go on": free.set,
        "raise": lambda: raising.add("/limb/get_grip"),
        "behave": raising.clear,
        "vanish": vanish,
        "come back": offer_grip,
        "grow": offer_arm,
        "forget": count.clear,
        "die": lambda: os._exit(1),
    }[request.words]()
    return SetWordsResponse(True, "")


rospy.init_node("limb")
awake = rospy.Publisher("/limb/awake", Bool, queue_size=1, latch=True)
level = rospy.Publisher("/limb/level", Float64, queue_size=1, latch=True)
awake.publish(False)
level.publish(0.25)
rospy.Subscriber("/limb/command", Float64, lambda message: level.publish(message.data))
rospy.set_param("/limb/name", "Bob")
rospy.set_param("/limb/pid", {"p": 1.5, "i": 0})
offer_grip()
offer("/limb/set_grip", SetByte, set_grip)
offer("/limb/getMode", GetWords, lambda _: GetWordsResponse(values["mode"]))
offer("/limb/setMode", SetWords, set_mode)
offer("/limb/span/get", GetRange, lambda _: GetRangeResponse(*values["span"]))
offer("/limb/span/set", SetRange, set_span)
offer("/limb/set_awake", SetBool, set_awake)
offer("/limb/get_ready", Trigger, lambda _: TriggerResponse(True, "ready"))
offer("/limb/get_map", GetMap, lambda _: GetMapResponse())
offer("/limb/relax", Empty, lambda _: EmptyResponse())
rospy.Service("/limb_control/tell", SetWords, tell)
rospy.Service("/limb_control/count", GetWords, lambda _: GetWordsResponse(json.dumps(count)))
print("ready", flush=True)
rospy.spin()
