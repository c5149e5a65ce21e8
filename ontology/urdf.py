"""Robot descriptions in URDF (https://wiki.ros.org/urdf/XML): links, joints and sensors, read from untrusted XML."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TypeAlias
from xml.etree.ElementTree import Element, ParseError, fromstring

from msgspec import Struct, field

Vector: TypeAlias = tuple[float, float, float]
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MAX_CHARACTERS = 4 * 1024 * 1024
MAX_PARTS = 10_000
"""Maximum number of links, joints and sensors."""
_MAX_PROBLEMS = 20
_MAX_SHOWN = 60
_WITHOUT_AXIS = ("fixed", "floating")
_ZERO: Vector = (0.0, 0.0, 0.0)
_X_AXIS: Vector = (1.0, 0.0, 0.0)


class UnreadableUrdf(ValueError):
    """Reason why a text is not a robot description: a sentence without its full stop."""


class Link(Struct, frozen=True):
    """A link, with its mass in kilograms."""

    name: str
    mass: float | None = None


class Joint(Struct, frozen=True):
    """A joint. `xyz` and `rpy` are its origin in the parent link: metres, and radians about the fixed axes x, y and z.

    `limits` (lower, upper, velocity, effort) are in SI units: radians, or metres for a prismatic joint. `mimics` is the
    joint whose position it copies.
    """

    name: str
    type: str
    parent: str
    child: str
    xyz: Vector = _ZERO
    rpy: Vector = _ZERO
    axis: Vector | None = None
    limits: Mapping[str, float] = {}
    mimics: str | None = None


class MountedSensor(Struct, frozen=True):
    """A sensor on a link."""

    name: str
    type: str | None
    link: str


class Urdf(Struct):
    """A robot description, without the parts that `problems` (sentences) are about."""

    name: str
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    sensors: dict[str, MountedSensor] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def roots(self) -> list[str]:
        """Names of the links that are no child of a joint."""
        children = {joint.child for joint in self.joints.values()}
        return [name for name in self.links if name not in children]

    def note(self, problem: str) -> None:
        """Add a problem; only the first ones are listed."""
        if len(self.problems) < _MAX_PROBLEMS:
            self.problems.append(problem)
        elif len(self.problems) == _MAX_PROBLEMS:
            self.problems.append("There are more problems.")


def read_urdf(text: str) -> Urdf:
    """Return the robot that a text describes. Raises UnreadableUrdf.

    Declarations of entities are refused, so that nothing is expanded or fetched.
    """
    if len(text) > MAX_CHARACTERS:
        raise UnreadableUrdf(f"It has {len(text):,} characters, more than {MAX_CHARACTERS:,}")
    if "<!DOCTYPE" in text:
        raise UnreadableUrdf("It has a document type declaration, which may define entities")
    try:
        root = fromstring(text)
    except (ParseError, ValueError) as error:
        raise UnreadableUrdf(f"It is not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise UnreadableUrdf(f"Its root is the element {_shown(root.tag)}, not robot")
    if sum(1 for _ in _parts(root)) > MAX_PARTS:
        raise UnreadableUrdf(f"It has more than {MAX_PARTS:,} links, joints and sensors")
    robot = Urdf(root.get("name") or "robot")
    for each in root.iterfind("link"):
        if (name := _new_name(each, robot, robot.links)) is not None:
            mass = each.find("inertial/mass")
            robot.links[name] = Link(name, None if mass is None else _number(mass, "value", robot, f"link {name}"))
    for each in root.iterfind("joint"):
        if (name := _new_name(each, robot, robot.joints)) is not None:
            _add_joint(each, name, robot)
    for each in root.iterfind("sensor"):
        _add_sensor(each, _linked(each.find("parent")), robot)
    for extension in root.iterfind("gazebo"):
        for each in extension.iterfind("sensor"):
            _add_sensor(each, extension.get("reference", ""), robot)
    _check_tree(robot)
    return robot


def _parts(root: Element) -> Iterator[Element]:
    for each in ("link", "joint", "sensor", "gazebo/sensor"):
        yield from root.iterfind(each)


def _new_name(element: Element, robot: Urdf, known: Mapping[str, object]) -> str | None:
    """Return the name of an element, or None if it cannot be used."""
    name = element.get("name", "")
    if not name:
        robot.note(f"A {element.tag} has no name.")
    elif name in known:
        robot.note(f"There are several {element.tag}s {_shown(name)}: only the first counts.")
    else:
        return name
    return None


def _add_joint(element: Element, name: str, robot: Urdf) -> None:
    about, type = f"joint {_shown(name)}", element.get("type", "")
    parent, child = (_linked(element.find(end)) for end in ("parent", "child"))
    if type not in JOINT_TYPES:
        robot.note(f"The {about} has the unknown type {_shown(type)}.")
    elif parent not in robot.links or child not in robot.links:
        missing = parent if parent not in robot.links else child
        robot.note(f"The {about} connects the link {_shown(missing)}, which is not described.")
    else:
        origin, axis, limit, mimic = (element.find(each) for each in ("origin", "axis", "limit", "mimic"))
        has_range = type not in ("continuous", *_WITHOUT_AXIS)
        defaults = {**({"lower": "0", "upper": "0"} if has_range else {}), "velocity": None, "effort": None}
        limits = {each: _number(limit, each, robot, about, default) for each, default in defaults.items()}
        robot.joints[name] = Joint(
            name,
            type,
            parent,
            child,
            _vector(origin, "xyz", robot, about, _ZERO),
            _vector(origin, "rpy", robot, about, _ZERO),
            None if type in _WITHOUT_AXIS else _vector(axis, "xyz", robot, about, _X_AXIS),
            {each: value for each, value in limits.items() if value is not None},
            None if mimic is None else mimic.get("joint"),
        )


def _linked(element: Element | None) -> str:
    return "" if element is None else element.get("link", "")


def _add_sensor(element: Element, link: str, robot: Urdf) -> None:
    name = _new_name(element, robot, robot.sensors)
    if name is None:
        return
    if link not in robot.links:
        robot.note(f"The sensor {_shown(name)} is on the link {_shown(link)}, which is not described.")
        return
    robot.sensors[name] = MountedSensor(name, element.get("type"), link)


def _number(element: Element | None, name: str, robot: Urdf, about: str, default: str | None = None) -> float | None:
    """Return an attribute of an element as a finite number, or None."""
    word = None if element is None else element.get(name, default)
    if word is None:
        return None
    numbers = _numbers(word)
    if len(numbers) != 1:
        robot.note(f"The {about} has the {name} {_shown(word)}, which is not a finite number.")
        return None
    return numbers[0]


def _vector(element: Element | None, name: str, robot: Urdf, about: str, default: Vector) -> Vector:
    word = None if element is None else element.get(name)
    if word is None:
        return default
    numbers = _numbers(word)
    if len(numbers) != 3:
        robot.note(f"The {about} has the {name} {_shown(word)}, which is not three finite numbers.")
        return default
    return numbers[0], numbers[1], numbers[2]


def _numbers(words: str) -> list[float]:
    """Return the numbers in a text, or an empty list if one is not finite."""
    try:
        numbers = [float(word) for word in words[:200].split()]
    except ValueError:
        return []
    return numbers if all(map(math.isfinite, numbers)) else []


def _check_tree(robot: Urdf) -> None:
    """Note links with several parents, cycles, and joints that mimic an unknown one."""
    parents: dict[str, str] = {}
    for name, joint in robot.joints.items():
        if joint.child in parents:
            robot.note(f"The link {_shown(joint.child)} is the child of several joints: the links are no tree.")
        parents.setdefault(joint.child, joint.parent)
        if joint.mimics is not None and joint.mimics not in robot.joints:
            robot.note(f"The joint {_shown(name)} mimics the joint {_shown(joint.mimics)}, which is not described.")
    below: set[str] = set()
    for start in robot.links:
        path: dict[str, None] = {}
        link: str | None = start
        while link is not None and link not in below and link not in path:
            path[link] = None
            link = parents.get(link)
        if link in path:
            robot.note(f"The link {_shown(str(link))} is below itself: the links are no tree.")
        below.update(path)


def _shown(name: str) -> str:
    """Return a name for a sentence, shortened if it is long."""
    return repr(name if len(name) <= _MAX_SHOWN else name[:_MAX_SHOWN] + "…")
