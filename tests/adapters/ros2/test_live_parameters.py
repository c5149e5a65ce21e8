"""Declarations of parameters by real nodes, and the values that they then accept."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import Descriptor, Kind, Operation, ParameterType, Range, Ref, Refused, TimedOut
from rosld.adapters.node_parameters import Parameters
from rosld.adapters.ros2 import message_classes
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow

READ, WRITE = Operation.GET_PARAMETER, Operation.SET_PARAMETER
DECLARED = {
    "/lamp/level": Descriptor(
        ParameterType.INTEGER, "How bright it is.", constraints="Even looks best.", range=Range(0, 20, 5)
    ),
    "/lamp/gain": Descriptor(ParameterType.DOUBLE, range=Range(0.0, 1.0, 0.1)),
    "/lamp/serial": Descriptor(ParameterType.STRING, read_only=True),
    "/lamp/any": Descriptor(dynamic_typing=True),
    "/lamp/weights": Descriptor(ParameterType.DOUBLE_ARRAY),
    "/lamp/later": Descriptor(ParameterType.INTEGER),
}


async def described(session: Any, name: str) -> Descriptor:
    """Return the declaration of a parameter, once it is known."""

    def found() -> Descriptor | None:
        parameter = session.graph.parameters.get(name)
        return None if parameter is None else parameter.descriptor

    told: Descriptor = await session.until(found, f"what is declared of {name}")
    return told


async def test_parameters_of_all_kinds_are_named_by_their_node(ros: Any) -> None:
    async with opened(ros) as session:
        await session.until(lambda: "/listener/seats" in session.graph.parameters)
        wanted = {
            "/listener/seats": 2,
            "/listener/speed": 1.5,
            "/listener/name": "Ada",
            "/listener/flying": False,
            "/listener/camera.exposures": [1.0, 2.0],
            "/listener/bytes": b"\x01\xff",
            "/listener/odd/name with spaces": [1, 2],
        }
        assert wanted.keys() <= session.graph.parameters.keys()
        assert {session.graph.parameters[name].node for name in wanted} == {"/listener"}
        found = await session.get_parameters(list(wanted))
        assert found == wanted
        assert [type(found[name]) for name in ("/listener/seats", "/listener/speed")] == [int, float]
        own = session.graph.own_node
        assert not any(name.startswith(f"{own}/") for name in session.graph.parameters)


async def test_what_another_sets_comes_by_the_events_of_its_node(ros: Any) -> None:
    async with opened(ros) as one, opened(ros) as other:
        name = "/free/told.by.event"
        await one.until(lambda: Operation.SET_PARAMETER in one.adapter.allows(Ref(Kind.PARAMETER, name)))
        await other.until(lambda: Operation.SET_PARAMETER in other.adapter.allows(Ref(Kind.PARAMETER, name)))
        await one.set_parameters({name: 1})
        await other.until(lambda: name in other.events.parameters)
        await other.until(lambda: name in other.graph.parameters)
        await one.delete_parameters([name])
        await other.until(lambda: name not in other.graph.parameters)


async def test_nodes_judge_as_they_declare_and_numbers_go_out_in_the_declared_type(ros: Any) -> None:
    async with opened(ros) as session:
        assert {name: await described(session, name) for name in DECLARED} == DECLARED
        allows = {name: session.adapter.allows(Ref(Kind.PARAMETER, name)) for name in DECLARED}
        assert allows["/lamp/level"] == {READ, WRITE}
        assert allows["/lamp/serial"] == {READ}
        assert allows["/lamp/any"] == {READ, WRITE, Operation.DELETE_PARAMETER}
        given = {"/lamp/gain": 1, "/lamp/level": 10.0, "/lamp/weights": [1, 2.5]}
        await session.set_parameters(given)
        found = await session.get_parameters(list(given))
        assert repr(found) == repr({"/lamp/gain": 1.0, "/lamp/level": 10, "/lamp/weights": [1.0, 2.5]})
        wrong = {"/lamp/level": 7, "/lamp/gain": 0.25, "/lamp/serial": "B8"}
        for name, value in {**wrong, "/listener/seats": "two", "/listener/never": 1}.items():
            with pytest.raises(Refused, match=name) as caught:
                await session.set_parameters({name: value})
            assert caught.value.words


async def test_what_a_node_declares_later_or_anew_is_asked_for_soon(ros: Any) -> None:
    async with opened(ros) as session:
        assert (await described(session, "/lamp/changed")).description == "As it was."
        await session.trigger("/lamp/grow")
        assert await described(session, "/lamp/grown") == Descriptor(ParameterType.BOOLEAN, "New.")
        parameters = lambda: session.graph.parameters  # noqa: E731
        await session.until(lambda: parameters()["/lamp/changed"].descriptor.description == "As it is.")
        await session.set_parameters({"/free/undeclared": 1})
        assert await described(session, "/free/undeclared") == Descriptor(dynamic_typing=True)
        await session.delete_parameters(["/free/undeclared"])


class Node:
    """A node's parameter services, which declare fewer parameters than they list, or do not describe them."""

    messages = message_classes

    def __init__(self, listed: list[str], declared: set[str], *, describes: bool = True) -> None:
        self.listed = listed
        self.declared = declared
        self.describes = describes
        self.asked: list[list[str]] = []

    async def call(self, service: str, type: str, request: Any, until: float) -> Any:
        from rcl_interfaces.msg import ListParametersResult, ParameterDescriptor
        from rcl_interfaces.srv import DescribeParameters, ListParameters

        if service.endswith("/list_parameters"):
            return ListParameters.Response(result=ListParametersResult(names=self.listed))
        assert service.endswith("/describe_parameters")
        if not self.describes:
            raise TimedOut("it did not answer")
        self.asked.append(list(request.names))
        known = self.declared.issuperset(request.names)
        return DescribeParameters.Response(
            descriptors=[ParameterDescriptor(type=2, description=name) for name in request.names] if known else []
        )


async def asked(node: Node) -> Parameters:
    """Return the declarations of a node that was queried once."""
    services = {
        "/n/list_parameters": ("rcl_interfaces/srv/ListParameters",),
        "/n/describe_parameters": ("rcl_interfaces/srv/DescribeParameters",),
    }
    parameters = Parameters(node, lambda names: None)  # type: ignore[arg-type]
    parameters.follow({"/n": services}, ())
    await parameters.queries.wait(10)
    return parameters


def test_a_name_that_is_not_declared_hides_no_other() -> None:
    names = [f"p{number:02}" for number in range(40)]
    node = Node(names, set(names) - {"p07", "p31"})
    found = asyncio.run(asked(node)).graph_parameters
    assert found.keys() == {f"/n/{name}" for name in names}
    assert {name for name, each in found.items() if each.descriptor is None} == {"/n/p07", "/n/p31"}
    assert found["/n/p08"].descriptor == Descriptor(ParameterType.INTEGER, "p08")
    assert len(node.asked) < len(names)


async def test_a_node_that_describes_nothing_still_has_its_parameters() -> None:
    parameters = await asked(Node(["a"], {"a"}, describes=False))
    assert parameters.graph_parameters["/n/a"].descriptor is None
    assert not parameters.unreachable
    soon = parameters.owners["/n"].query_at - asyncio.get_running_loop().time()
    assert soon < 10
