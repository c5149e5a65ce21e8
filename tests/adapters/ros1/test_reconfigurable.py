"""Parameters of dynamic_reconfigure, with its real server: described by the node, and set effectively."""

from __future__ import annotations

import asyncio
import json
import math
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import Choice, Descriptor, Kind, Operation, ParameterType, Range, Ref, TypeRef
from rosld.adapters.ros1.reconfigurable import read_config, read_descriptors, request_of
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem, require
from tests.adapters.session import Session

pytestmark = pytest.mark.slow

DECLARED = {
    "/arm/speed": Descriptor(ParameterType.DOUBLE, "How fast it moves, in rad/s.", range=Range(0.0, 2.0)),
    "/arm/offset": Descriptor(ParameterType.DOUBLE),
    "/arm/joints": Descriptor(ParameterType.INTEGER, "How many joints it uses.", range=Range(1, 7)),
    "/arm/mode": Descriptor(
        ParameterType.INTEGER,
        "How it moves",
        range=Range(0, 3),
        choices=(Choice(0, "Slow", "For people nearby"), Choice(1, "Fast"), Choice(3, "Broken", "Never")),
    ),
    "/arm/tool": Descriptor(
        ParameterType.STRING,
        "What it holds",
        choices=(Choice("gripper", "Gripper", "Two fingers"), Choice("cup", "Cup")),
    ),
    "/arm/label": Descriptor(ParameterType.STRING, "What it is called, such as ü"),
    "/arm/enabled": Descriptor(ParameterType.BOOLEAN, "Whether it moves at all."),
    "/arm/gripper/force": Descriptor(ParameterType.INTEGER, "In newtons.", range=Range(0, 50)),
}


@pytest.fixture(scope="module")
def arm(ros: RosSystem) -> RosSystem:
    """The system with a node of two servers."""
    require("a server of dynamic_reconfigure", "dynamic_reconfigure.server")
    ros.node("reconfigurable_node.py")
    return ros


async def described(session: Session) -> None:
    """Wait until all declarations of the node are known."""
    parameters = lambda: session.graph.parameters  # noqa: E731
    await session.until(lambda: all(one in parameters() and parameters()[one].descriptor for one in DECLARED))


async def set_to(session: Session, **values: Any) -> None:
    """Set parameters of the arm."""
    named = {f"/arm/{name}": value for name, value in values.items()}
    await session.set_parameters(named, seconds=20)


async def value(session: Session, *names: str) -> list[Any]:
    """Return the values of parameters of the arm."""
    full = [f"/arm/{name}" for name in names]
    found = await session.get_parameters(full, seconds=20)
    return [found[name] for name in full]


async def test_what_a_node_declares_is_in_the_graph_and_looking_registers_nothing(arm: RosSystem) -> None:
    before = arm.master.getSystemState("/test")[2]
    async with opened(arm) as session:
        await described(session)
        for name, descriptor in {**DECLARED, "/arm/frame": None}.items():
            parameter = session.graph.parameters[name]
            assert (parameter.node, parameter.descriptor) == (descriptor and "/arm", descriptor)
            allowed = session.adapter.allows(Ref(Kind.PARAMETER, name))
            assert (Operation.DELETE_PARAMETER in allowed) is (descriptor is None)
        assert arm.master.getSystemState("/test")[2] == before


async def test_a_tree_that_is_set_whole_takes_effect_too(arm: RosSystem) -> None:
    async with opened(arm) as session:
        await described(session)
        await session.set_parameters({"/arm/gripper": {"force": 30, "color": "red"}}, seconds=20)
        assert await value(session, "gripper") == [{"force": 30, "color": "red"}]
        updates = await session.adapter.subscribe("/arm/gripper/parameter_updates")
        (sample,) = await session.first(updates)
        assert [(one.name, one.value) for one in (await session.decoded(sample)).ints] == [("force", 30)]


async def test_what_a_node_decides_by_itself_is_told(arm: RosSystem) -> None:
    async with opened(arm) as session:
        await described(session)
        await set_to(session, speed=0.0)
        session.events.parameters.clear()
        ref, data = TypeRef("std_msgs/msg/String"), json.dumps({"speed": 1.5}).encode()
        data = len(data).to_bytes(4, "little") + data
        await session.publish("/arm/decide", ref, data)
        read: list[object] = []
        while read != [1.5]:  # the first update may still be that of the 0.0 above
            await session.until(lambda: "/arm/speed" in session.events.parameters)
            session.events.parameters.clear()
            read = await value(session, "speed")


async def test_a_node_that_comes_later_and_goes_is_noticed(lone_ros: RosSystem) -> None:
    require("a server of dynamic_reconfigure", "dynamic_reconfigure.server")
    async with opened(lone_ros) as session:
        node = await asyncio.to_thread(lone_ros.node, "reconfigurable_node.py")
        await described(session)
        await asyncio.to_thread(node.kill)
        await asyncio.to_thread(lone_ros.run, "/usr/bin/rosnode", "list")
        for service in ("set_parameters", "gripper/set_parameters"):
            uri = lone_ros.master.lookupService("/test", f"/arm/{service}")[2]
            lone_ros.master.unregisterService("/arm", f"/arm/{service}", uri)
        await session.until(lambda: not any(one.descriptor for one in session.graph.parameters.values()))
        await set_to(session, speed=9.0)
        assert await value(session, "speed") == [9.0]


# The wire


def genpy(ros: RosSystem, program: str, *arguments: str) -> str:
    """Return the output of a program that uses dynamic_reconfigure's own message classes."""
    return ros.run(
        "/usr/bin/python3", "-c", f"import io, sys\nfrom dynamic_reconfigure.msg import *\n{program}", *arguments
    )


def test_a_configuration_is_written_and_read_as_genpy_does(ros: RosSystem) -> None:
    require("the messages of dynamic_reconfigure", "dynamic_reconfigure.msg")
    values = {"on": True, "off": False, "count": -5, "words": "ü 'x'", "nothing": "", "ratio": 0.1, "end": math.inf}
    read = genpy(
        ros,
        "config = Config().deserialize(bytes.fromhex(sys.argv[1]))\n"
        "print({one.name: one.value for one in config.bools + config.ints + config.strs + config.doubles})\n"
        "config.groups.append(GroupState('Default', True, 0, 0))\n"
        "found = io.BytesIO()\nconfig.serialize(found)\nprint(found.getvalue().hex())",
        request_of(values).hex(),
    )
    told, octets, *_ = read.splitlines()
    assert eval(told, {"inf": math.inf}) == values
    assert read_config(bytes.fromhex(octets)) == values


METHODS = {
    "{'enum_description': 'x', 'enum': [{'name': 'A', 'value': 1, 'srcline': 5, 'type': 'int'}]}": (1,),
    "{u'enum': [{u'name': u'A', u'value': 1}, {'name': 'B', 'value': 2.0}]}": (1, 2),
    "{'enum': [{'value': 'one'}, {'value': 1.5}, {'value': True}, {'name': 'none'}, 'x', 7]}": (),
    "": (),
    "{}": (),
    "[1, 2]": (),
    "{'enum': 5}": (),
    "{'enum': ": (),
    "{'enum': [{'value': __import__('os')}]}": (),
    "{'enum': [{'value': 1 + 1}]}": (),
    "(" * 5000 + ")" * 5000: (),
    "-" * 50_000 + "1": (),
    "{'enum': [{'value': 1}]}" + " " * 200_000: (),
}


def test_an_enumeration_is_read_from_what_is_plain_data(ros: RosSystem, tmp_path: Path) -> None:
    require("the messages of dynamic_reconfigure", "dynamic_reconfigure.msg")
    (tmp_path / "methods").write_text(json.dumps(list(METHODS)))
    octets = genpy(
        ros,
        "import json\n"
        "for method in json.load(open(sys.argv[1])):\n"
        "    one = ParamDescription('x', 'int', 0, 'words', method)\n"
        "    message = ConfigDescription([Group('Default', '', [one], 0, 0)], Config(), Config(), Config())\n"
        "    found = io.BytesIO()\n    message.serialize(found)\n    print(found.getvalue().hex())",
        str(tmp_path / "methods"),
    )
    for expected, line in zip(METHODS.values(), octets.split(), strict=True):
        found = read_descriptors(bytes.fromhex(line))["x"]
        assert tuple(choice.value for choice in found.choices) == expected
        assert (found.type, found.description, found.range) == (ParameterType.INTEGER, "words", None)


def test_a_truncated_message_is_refused() -> None:
    for data in (b"", b"\1", b"\1\0\0\0", b"\xff" * 40, b"\0" * 7):
        for read in (read_config, read_descriptors):
            with pytest.raises(ValueError, match="cannot decode"):
                read(data)
