"""Parameters of a real master in both directions, including odd ones, and changes noticed without a trace."""

from __future__ import annotations

import asyncio
import xmlrpc.client
from datetime import datetime

import pytest

from rosld.adapters.model import Kind, Operation, Ref, Refused
from rosld.adapters.model.parameter import ParameterValue
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem

pytestmark = pytest.mark.slow

VALUES: dict[str, ParameterValue] = {
    "/values/bool": True,
    "/values/int": -(2**31),
    "/values/float": 0.1 + 0.2,
    "/values/text": "ümlaut 🤖 <&> \t \n 'quoted'",
    "/values/empty": "",
    "/values/list": [1, "two", [3.0, False]],
    "/values/tree": {"deep": {"deeper": 1}},
    "/values/bytes": b"\0\xff\x80",
    "/values/date": datetime(2026, 11, 21, 12, 30, 1),
}


async def test_parameters_are_exchanged_with_rosparam_and_keep_their_types(ros: RosSystem) -> None:
    async with opened(ros) as session:
        await session.set_parameters(VALUES)
        found = await session.get_parameters(list(VALUES))
        assert {name: (type(value), value) for name, value in found.items()} == {
            name: (type(value), value) for name, value in VALUES.items()
        }
        assert "/values/tree/deep/deeper" in session.graph.parameters
        assert "/values/tree" not in session.graph.parameters
        read = await asyncio.to_thread(ros.run, "/usr/bin/rosparam", "get", "/values/list")
        assert ros.yaml(read) == VALUES["/values/list"]
        await asyncio.to_thread(ros.run, "/usr/bin/rosparam", "set", "/theirs", "{a: 1, b: [x, 2.5]}")
        found = await session.get_parameters(["/theirs", "/theirs/b"])
        assert found == {"/theirs": {"a": 1, "b": ["x", 2.5]}, "/theirs/b": ["x", 2.5]}
        ros.master.setParam("/test", "/blob", xmlrpc.client.Binary(b"\0\1\2"))
        ros.master.setParam("/test", "/when", xmlrpc.client.DateTime("20261121T01:02:03"))
        found = await session.get_parameters(["/blob", "/when"])
        assert found == {"/blob": b"\0\1\2", "/when": datetime(2026, 11, 21, 1, 2, 3)}


async def test_names_with_empty_segments_and_slashes_in_keys_survive(ros: RosSystem) -> None:
    ros.master.setParam("/test", "/even", 2)
    ros.master.setParam("/test", "/odd", {"a/b": 1, "": 2, "c": {"": {"d": 3}}, "none": {}})
    async with opened(ros) as session:
        names = ["/odd/a/b", "/odd/", "/odd/c//d", "/odd/c/", "/odd/a", "/odd/none", "/odd/c"]
        assert {"/odd/a/b", "/odd/", "/odd/c//d"} < session.graph.parameters.keys()
        assert await session.get_parameters(names) == {
            "/odd/a/b": 1,
            "/odd/": 2,
            "/odd/c//d": 3,
            "/odd/c/": {"d": 3},
            "/odd/none": {},
            "/odd/c": {"": {"d": 3}},
        }
        for name in ("/odd/a/b", "/odd/", "/odd/c//d"):
            with pytest.raises(Refused):
                await session.set_parameters({name: 5})
            with pytest.raises(Refused):
                await session.delete_parameters([name])
            assert session.adapter.allows(Ref(Kind.PARAMETER, name)) == {Operation.GET_PARAMETER}
        assert Operation.DELETE_PARAMETER in session.adapter.allows(Ref(Kind.PARAMETER, "/odd/none"))
        assert ros.master.getParam("/test", "/odd")[2] == {"a/b": 1, "": 2, "c": {"": {"d": 3}}, "none": {}}


async def test_changes_by_others_are_told_without_subscribing(ros: RosSystem) -> None:
    ros.master.setParam("/test", "/watched", {"a": 1, "b": 2})
    async with opened(ros) as session:
        session.events.parameters.clear()
        ros.master.setParam("/test", "/watched/a", 5)
        await session.until(lambda: "/watched/a" in session.events.parameters, "the hint")
        assert session.events.parameters == ["/watched/a"]
        ros.master.deleteParam("/test", "/watched/b")
        await session.until(lambda: "/watched/b" not in session.graph.parameters, "it is gone from the graph")
        assert "/watched/b" in session.events.parameters
        assert session.graph.simulated_time is False
        ros.master.setParam("/test", "/use_sim_time", True)
        await session.until(lambda: session.graph.simulated_time, "simulated time")
        ros.master.deleteParam("/test", "/use_sim_time")
        await session.until(lambda: not session.graph.simulated_time, "real time")
