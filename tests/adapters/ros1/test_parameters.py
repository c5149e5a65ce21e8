"""Parameters of a real master, both ways, the odd ones included, and changes noticed without a trace."""

from __future__ import annotations

import asyncio
import xmlrpc.client
from datetime import datetime

import pytest

from rosld.adapters.base import ParameterValue
from rosld.adapters.model import Kind, NotFound, Operation, Ref, Refused
from tests.adapters.ros1.conftest import Opening
from tests.adapters.ros1.system import RosSystem

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


def test_what_is_set_here_is_read_by_rosparam_and_the_other_way_round(ros: RosSystem, opened: Opening) -> None:
    async def exchange() -> None:
        async with opened(ros) as session:
            await session.adapter.set_parameters(
                {"/ours/gain": 0.5, "/ours/name": "héllo"}, deadline=session.deadline()
            )
            read = await asyncio.to_thread(ros.run, "/usr/bin/rosparam", "get", "/ours")
            assert ros.yaml(read) == {"gain": 0.5, "name": "héllo"}
            await asyncio.to_thread(ros.run, "/usr/bin/rosparam", "set", "/theirs", "{a: 1, b: [x, 2.5]}")
            found = await session.adapter.get_parameters(["/theirs", "/theirs/b"], deadline=session.deadline())
            assert found == {"/theirs": {"a": 1, "b": ["x", 2.5]}, "/theirs/b": ["x", 2.5]}

    asyncio.run(exchange())


def test_every_kind_of_value_comes_back_as_it_was_set(ros: RosSystem, opened: Opening) -> None:
    async def exchange() -> None:
        async with opened(ros) as session:
            await session.adapter.set_parameters(VALUES, deadline=session.deadline())
            found = await session.adapter.get_parameters(list(VALUES), deadline=session.deadline())
            assert {name: (type(value), value) for name, value in found.items()} == {
                name: (type(value), value) for name, value in VALUES.items()
            }
            assert "/values/tree/deep/deeper" in session.graph.parameters
            assert "/values/tree" not in session.graph.parameters

    asyncio.run(exchange())


def test_names_with_empty_segments_and_slashes_in_keys_survive(ros: RosSystem, opened: Opening) -> None:
    ros.master.setParam("/test", "/odd", {"a/b": 1, "": 2, "c": {"": {"d": 3}}, "none": {}})

    async def read() -> None:
        async with opened(ros) as session:
            names = ["/odd/a/b", "/odd/", "/odd/c//d", "/odd/c/", "/odd/a", "/odd/none", "/odd/c"]
            assert {"/odd/a/b", "/odd/", "/odd/c//d"} < session.graph.parameters.keys()
            assert await session.adapter.get_parameters(names, deadline=session.deadline()) == {
                "/odd/a/b": 1,
                "/odd/": 2,
                "/odd/c//d": 3,
                "/odd/c/": {"d": 3},
                "/odd/none": {},
                "/odd/c": {"": {"d": 3}},
            }
            for name in ("/odd/a/b", "/odd/", "/odd/c//d"):
                with pytest.raises(Refused):
                    await session.adapter.set_parameters({name: 5}, deadline=session.deadline())
                with pytest.raises(Refused):
                    await session.adapter.delete_parameters([name], deadline=session.deadline())
                assert session.adapter.allows(Ref(Kind.PARAMETER, name)) == {Operation.GET_PARAMETER}
            assert Operation.DELETE_PARAMETER in session.adapter.allows(Ref(Kind.PARAMETER, "/odd/none"))
            assert ros.master.getParam("/test", "/odd")[2] == {"a/b": 1, "": 2, "c": {"": {"d": 3}}, "none": {}}

    asyncio.run(read())


def test_binary_and_dates_of_others_arrive(ros: RosSystem, opened: Opening) -> None:
    ros.master.setParam("/test", "/blob", xmlrpc.client.Binary(b"\0\1\2"))
    ros.master.setParam("/test", "/when", xmlrpc.client.DateTime("20261121T01:02:03"))

    async def read() -> None:
        async with opened(ros) as session:
            found = await session.adapter.get_parameters(["/blob", "/when"], deadline=session.deadline())
            assert found == {"/blob": b"\0\1\2", "/when": datetime(2026, 11, 21, 1, 2, 3)}

    asyncio.run(read())


@pytest.mark.parametrize("value", [2**31, None, float("nan"), "\x07", {"a": [float("inf")]}])
def test_what_the_wire_cannot_carry_is_refused_and_nothing_of_the_batch_is_set(
    ros: RosSystem, opened: Opening, value: ParameterValue
) -> None:
    async def attempt() -> None:
        async with opened(ros) as session:
            with pytest.raises(Refused, match="/batch/bad"):
                await session.adapter.set_parameters(
                    {"/batch/good": 1, "/batch/bad": value}, deadline=session.deadline()
                )
            assert await session.adapter.get_parameters(["/batch"], deadline=session.deadline()) == {}

    asyncio.run(attempt())


def test_deleting_takes_a_tree_whole_and_says_when_there_is_none(ros: RosSystem, opened: Opening) -> None:
    async def delete() -> None:
        async with opened(ros) as session:
            await session.adapter.set_parameters({"/gone": {"a": 1, "b": {"c": 2}}}, deadline=session.deadline())
            ref = Ref(Kind.PARAMETER, "/gone/b")
            assert Operation.DELETE_PARAMETER in session.adapter.allows(ref)
            await session.adapter.delete_parameters(["/gone/b", "/gone"], deadline=session.deadline())
            assert not [name for name in session.graph.parameters if name.startswith("/gone")]
            assert session.adapter.allows(ref) == {Operation.SET_PARAMETER}
            with pytest.raises(NotFound, match="/gone"):
                await session.adapter.delete_parameters(["/gone"], deadline=session.deadline())
            with pytest.raises(Refused):
                await session.adapter.delete_parameters(["/"], deadline=session.deadline())

    asyncio.run(delete())


def test_changes_by_others_are_told_without_subscribing(ros: RosSystem, opened: Opening) -> None:
    ros.master.setParam("/test", "/watched", {"a": 1, "b": 2})

    async def watch() -> None:
        async with opened(ros) as session:
            session.told.parameters.clear()
            ros.master.setParam("/test", "/watched/a", 5)
            await session.until(lambda: "/watched/a" in session.told.parameters, "the hint")
            assert session.told.parameters == ["/watched/a"]
            ros.master.deleteParam("/test", "/watched/b")
            await session.until(lambda: "/watched/b" not in session.graph.parameters, "it is gone from the graph")
            assert "/watched/b" in session.told.parameters

    asyncio.run(watch())


def test_simulated_time_is_seen(ros: RosSystem, opened: Opening) -> None:
    async def watch() -> None:
        async with opened(ros) as session:
            assert session.graph.simulated_time is False
            await session.adapter.set_parameters({"/use_sim_time": True}, deadline=session.deadline())
            await session.until(lambda: session.graph.simulated_time, "simulated time")
            await session.adapter.delete_parameters(["/use_sim_time"], deadline=session.deadline())
            await session.until(lambda: not session.graph.simulated_time, "real time")

    asyncio.run(watch())
