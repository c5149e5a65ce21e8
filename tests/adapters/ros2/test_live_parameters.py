"""What real nodes declare of their parameters, and what they then take."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import Descriptor, Kind, Operation, ParameterType, Range, Ref, Refused, TimedOut
from rosld.adapters.ros2.parameters import Parameters

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
    """What is declared of a parameter, once that is known."""

    def found() -> Descriptor | None:
        parameter = session.graph.parameters.get(name)
        return None if parameter is None else parameter.descriptor

    told: Descriptor = await session.until(found, f"what is declared of {name}")
    return told


def test_what_nodes_declare_is_in_the_graph(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            assert {name: await described(session, name) for name in DECLARED} == DECLARED
            allows = {name: session.adapter.allows(Ref(Kind.PARAMETER, name)) for name in DECLARED}
            assert allows["/lamp/level"] == {READ, WRITE}
            assert allows["/lamp/serial"] == {READ}
            assert allows["/lamp/any"] == {READ, WRITE, Operation.DELETE_PARAMETER}

    asyncio.run(scenario())


def test_a_number_goes_out_in_the_type_that_is_declared(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            await described(session, "/lamp/gain")
            given = {"/lamp/gain": 1, "/lamp/level": 10.0, "/lamp/weights": [1, 2.5]}
            await session.adapter.set_parameters(given, deadline=session.deadline())
            found = await session.adapter.get_parameters(list(given), deadline=session.deadline())
            assert repr(found) == repr({"/lamp/gain": 1.0, "/lamp/level": 10, "/lamp/weights": [1.0, 2.5]})

    asyncio.run(scenario())


@pytest.mark.parametrize(("name", "value"), [("/lamp/level", 7), ("/lamp/gain", 0.25), ("/lamp/serial", "B8")])
def test_the_nodes_judge_as_they_declare(ros: Any, opened: Any, name: str, value: object) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            await described(session, name)
            with pytest.raises(Refused, match=name):
                await session.adapter.set_parameters({name: value}, deadline=session.deadline())

    asyncio.run(scenario())


def test_what_a_node_declares_later_or_anew_is_asked_for_soon(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            assert (await described(session, "/lamp/changed")).description == "As it was."
            await session.trigger("/lamp/grow")
            assert await described(session, "/lamp/grown") == Descriptor(ParameterType.BOOLEAN, "New.")
            parameters = lambda: session.graph.parameters  # noqa: E731
            await session.until(lambda: parameters()["/lamp/changed"].descriptor.description == "As it is.")
            await session.adapter.set_parameters({"/free/undeclared": 1}, deadline=session.deadline())
            assert await described(session, "/free/undeclared") == Descriptor(dynamic_typing=True)
            await session.adapter.delete_parameters(["/free/undeclared"], deadline=session.deadline())

    asyncio.run(scenario())


class Node:
    """A node's services of parameters, of which it declares some less than it lists; or does not describe any."""

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
    """What is known of the parameters of a node that was asked once."""
    services = {
        "/n/list_parameters": ("rcl_interfaces/srv/ListParameters",),
        "/n/describe_parameters": ("rcl_interfaces/srv/DescribeParameters",),
    }
    parameters = Parameters(node, lambda names: None)  # type: ignore[arg-type]
    parameters.follow({"/n": services}, ())
    await parameters.wait_settled(10)
    return parameters


def test_a_name_that_is_not_declared_hides_no_other(ros: Any) -> None:
    names = [f"p{number:02}" for number in range(40)]
    node = Node(names, set(names) - {"p07", "p31"})
    found = asyncio.run(asked(node)).graph_parameters
    assert found.keys() == {f"/n/{name}" for name in names}
    assert {name for name, each in found.items() if each.descriptor is None} == {"/n/p07", "/n/p31"}
    assert found["/n/p08"].descriptor == Descriptor(ParameterType.INTEGER, "p08")
    assert len(node.asked) < len(names)


def test_a_node_that_describes_nothing_still_has_its_parameters(ros: Any) -> None:
    async def scenario() -> None:
        node = Node(["a"], {"a"}, describes=False)
        parameters = await asked(node)
        assert parameters.graph_parameters["/n/a"].descriptor is None
        assert not parameters.unreachable
        soon = parameters.owners["/n"].ask_at - asyncio.get_running_loop().time()
        assert soon < 10

    asyncio.run(scenario())
