"""The paper's aircraft as a rospy node, equivalent to rosld's embedded one, for tests on a real ROS.

    aircraft_node.py FOLDER_OF_GENERATED_CLASSES

Debian's generator writes its service classes, from rosld's own definitions, into that folder. Its cockpit is a separate
node, `cockpit_node.py`.
"""

import subprocess
import sys
import threading
import time
from pathlib import Path

import rospy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger, TriggerResponse

DEFINITIONS = Path(__file__).resolve().parents[4] / "adapters/model/definitions/rosld_aircraft/srv"
ACCELERATION = 100.0
RATE = 10.0
PARAMETERS = {
    "/aircraft": {
        "registration": "RO-SLD",
        "seats": 2,
        "engine": {"cylinders": 6, "limits": {"oil_pressure": 4.5, "temperature": 230.0}},
    },
    "/cockpit": {"brightness": 0.8, "night": False, "checklist": ["fuel", "flaps", "radio"]},
}


def generate(folder):
    """Generate the Python package rosld_aircraft in a folder."""
    package = folder / "rosld_aircraft"
    services = package / "srv"
    if not (package / "__init__.py").exists():
        services.mkdir(parents=True)
        sources = sorted(map(str, DEFINITIONS.glob("*.srv")))
        subprocess.run(
            ["/usr/bin/python3", "/usr/lib/genpy/gensrv_py.py", "-p", "rosld_aircraft", "-o", str(services), *sources],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        lines = [f"from ._{Path(each).stem} import *" for each in sources]
        (services / "__init__.py").write_text("\n".join(lines) + "\n")
        (package / "__init__.py").write_text("")
    sys.path.insert(0, str(folder))


class Declined(Exception):
    """A command that the aircraft refuses in its current state."""


class Aircraft:
    """Power, speed and direction; the speed approaches the command by 100 per second."""

    def __init__(self):
        self.lock = threading.Lock()
        self.on = False
        self.speed = 0.0
        self.commanded = 0.0
        self.direction = 0.0
        self.at = time.monotonic()

    def advance(self):
        now = time.monotonic()
        step = ACCELERATION * (now - self.at)
        way = self.commanded - self.speed
        self.speed = self.commanded if abs(way) <= step else self.speed + (step if way > 0 else -step)
        self.at = now
        return self.speed

    def start(self):
        if self.on:
            raise Declined("the aircraft is already started")
        self.on = True

    def stop(self):
        if self.on and self.speed > 0:
            raise Declined("the aircraft still moves: set the speed to 0 first")
        self.on = False
        self.speed = self.commanded = 0.0

    def power(self, word):
        if word not in ("on", "off"):
            raise Declined(f"the power is 'on' or 'off', not {word!r}")
        if word == "on":
            self.start()
        else:
            self.stop()

    def accelerate(self, speed):
        self.commanded = self.settable("speed", speed, 1000.0)

    def turn(self, direction):
        self.direction = self.settable("direction", direction, 360.0)

    def settable(self, what, value, limit):
        if not self.on:
            raise Declined(f"the aircraft is off: start it before setting its {what}")
        if not 0.0 <= value <= limit:  # NaN is within no range
            raise Declined(f"the {what} must be between 0 and {limit:g}, not {value:g}")
        return value + 0.0


def serve(aircraft, name, kind, response, act, done):
    """Offer a command as a service with success and message."""

    def answer(request):
        with aircraft.lock:
            aircraft.advance()
            try:
                act(request)
            except Declined as words:
                return response(False, str(words))
        return response(True, done)

    rospy.Service(name, kind, answer)


def main():
    generate(Path(sys.argv[1]))
    from rosld_aircraft.srv import (
        GetNumber,
        GetNumberResponse,
        GetText,
        GetTextResponse,
        SetNumber,
        SetNumberResponse,
        SetText,
        SetTextResponse,
    )

    rospy.init_node("aircraft")
    aircraft = Aircraft()
    speed = rospy.Publisher("/aircraft/engine/speed", Float64, queue_size=10)
    for name, value in PARAMETERS.items():
        rospy.set_param(name, value)
    serve(aircraft, "/aircraft/start", Trigger, TriggerResponse, lambda _: aircraft.start(), "started")
    serve(aircraft, "/aircraft/stop", Trigger, TriggerResponse, lambda _: aircraft.stop(), "stopped")
    serve(aircraft, "/aircraft/set_power", SetText, SetTextResponse, lambda r: aircraft.power(r.data), "power set")
    rospy.Service("/aircraft/get_power", GetText, lambda _: GetTextResponse("on" if aircraft.on else "off"))
    number, answer = SetNumber, SetNumberResponse
    serve(aircraft, "/aircraft/engine/set_speed", number, answer, lambda r: aircraft.accelerate(r.data), "speed set")
    serve(aircraft, "/aircraft/engine/set_direction", number, answer, lambda r: aircraft.turn(r.data), "direction set")
    rospy.Service("/aircraft/engine/get_direction", GetNumber, lambda _: GetNumberResponse(aircraft.direction))
    print("ready", flush=True)
    rate = rospy.Rate(RATE)
    while not rospy.is_shutdown():
        with aircraft.lock:
            speed.publish(aircraft.advance())
        rate.sleep()


main()
