"""Parameters: the one resource of ROS with all of create, read, update and delete (paper, Table 2)."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Kind, Operation, ParameterValue, Ref, names
from rosld.ontology.body import parse_body
from rosld.ontology.lower import parse_json
from rosld.ontology.parameters import (
    lower_json,
    lower_parameter,
    parameter_container_document,
    parameter_document,
    parameter_json,
    plain,
)
from rosld.server.events.watches import every, together
from rosld.server.html import DeleteForm, Form, ParameterForm
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.patch import merge_patch, updated
from rosld.server.ldp.resource import (
    BASIC_CONTAINER,
    JSON,
    MERGE_PATCH,
    RDF_BODIES,
    RDF_SOURCE,
    READ,
    RESOURCE,
    SPARQL_UPDATE,
    Answer,
    Created,
    Resource,
    moved,
)
from rosld.server.ldp.state import State, digest
from rosld.server.resources.limits import require_parameter
from rosld.server.robot import Robot
from rosld.server.writable import closed

_MOST_SLUG = 100
_LOOK_AGAIN_SECONDS = 1.0
"""How often a parameter that is watched is read again: not every kind of robot tells of all changes."""


class _Parameters(Resource):
    """What a single parameter and a tree of them have in common."""

    def __init__(self, robot: Robot, name: str, url: str) -> None:
        super().__init__(url)
        self.title = name
        self.robot = robot
        self.name = name

    def why_not(self, method: str) -> str:
        if self.robot.settings.read_only:
            return "This server is read-only."
        if self.robot.is_closed(self.name):
            return closed(self.name)
        return f"The parameters of this {self.robot.adapter.capabilities.system} do not answer {method} here."

    @property
    def constrained_by(self) -> str | None:
        return self.robot.space.shape("limits")

    def _can(self, operation: Operation) -> bool:
        if self.robot.settings.read_only or self.robot.is_closed(self.name):
            return False
        return operation in self.robot.adapter.allows(Ref(Kind.PARAMETER, self.name))

    async def _value(self) -> ParameterValue | None:
        deadline = self.robot.deadline(self.robot.settings.call_deadline)
        return (await self.robot.adapter.get_parameters([self.name], deadline=deadline)).get(self.name)

    def _plain(self, value: ParameterValue) -> bytes:
        """The value as plain JSON; a 406 Problem for one that another node nested too deep to be shown."""
        try:
            return parameter_json(value)
        except ValueError as error:
            raise Problem(406, f"{self.name} cannot be shown: {error}.") from error

    async def watch(self, wake: Callable[[], None]) -> Watch:
        told = self.robot.parameter_changes.watch(wake, lambda name: _related(name, self.name))
        return together(told, every(_LOOK_AGAIN_SECONDS, wake))

    async def _set(self, values: Mapping[str, ParameterValue]) -> None:
        for name, value in values.items():
            self._require_open(name, value)
            await require_parameter(self.robot, name, value)
        deadline = self.robot.deadline(self.robot.settings.call_deadline)
        try:
            await self.robot.adapter.set_parameters(values, deadline=deadline)
        finally:
            self._written(values)

    async def _delete(self, gone: Sequence[str]) -> None:
        for name in gone:
            self._require_open(name, {})
        deadline = self.robot.deadline(self.robot.settings.call_deadline)
        try:
            await self.robot.adapter.delete_parameters(gone, deadline=deadline)
        finally:
            self._written(gone)

    def _written(self, changed: Iterable[str]) -> None:
        for name in changed:
            for each in (name, *_below(name, self.robot)):
                self.robot.written(Kind.PARAMETER, each)

    def _require_open(self, name: str, value: ParameterValue) -> None:
        """Raise a 409 Problem where a tree holds, or would hold, a name that is written under /resources/ only."""
        for each in (name, *_below(name, self.robot), *_leaves(name, value)):
            if self.robot.is_closed(each):
                raise Problem(409, closed(each))

    async def delete(self, exchange: Exchange) -> Answer:
        if await self._value() is None:
            raise Problem(404, f"There is no parameter {self.name}.")
        await self._delete([self.name])
        return Response(status_code=204)


class ParameterResource(_Parameters):
    """One parameter that is no tree."""

    kind = "Parameter"
    accepts: Mapping[str, Sequence[str]] = {"PUT": (*RDF_BODIES, JSON), "PATCH": (MERGE_PATCH, SPARQL_UPDATE)}

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot, name, robot.space.parameter(name))

    def methods(self) -> frozenset[str]:
        methods = READ
        if self._can(Operation.SET_PARAMETER):
            methods |= {"PUT", "PATCH"}
        if self._can(Operation.DELETE_PARAMETER):
            methods |= {"DELETE"}
        return methods

    async def state(self) -> State:
        value = await self._value()
        if value is None:
            raise Problem(404, f"There is no parameter {self.name}.")
        if isinstance(value, dict):
            raise moved(self._tree_url())
        return self._shown(value)

    def _tree_url(self) -> str:
        return self.robot.space.container("parameters", names.segments(self.name))

    def _shown(self, value: ParameterValue) -> State:
        plain = self._plain(value)
        return self.robot.states.get(
            self.url,
            plain,
            lambda: State(lambda: parameter_document(self.name, value, self.robot.space), lambda: plain, digest(plain)),
        )

    async def forms(self) -> Sequence[Form]:
        methods, value = self.methods(), await self._value()
        forms: list[Form] = []
        if "PUT" in methods and value is not None:
            forms.append(ParameterForm(plain(value)))
        if "DELETE" in methods:
            forms.append(DeleteForm("Delete the parameter"))
        return forms

    async def put(self, exchange: Exchange) -> Answer:
        value = await self._parsed(exchange)
        before = await self._value()
        self._check_place(value, before)
        await self._set({self.name: value})
        if before is not None:
            return Response(status_code=204)
        if isinstance(value, dict):
            tree = ParameterTree(self.robot, names.segments(self.name))
            return Created(tree.url, tree, await tree.state())
        return Created(self.url, self, self._shown(value))

    async def _parsed(self, exchange: Exchange) -> ParameterValue:
        data = await exchange.body()
        if exchange.media_type == JSON:
            return lower_json(parse_json(data))
        return lower_parameter(parse_body(data, exchange.media_type, self.url), self.url)

    def _check_place(self, value: ParameterValue, before: ParameterValue | None) -> None:
        """A value never wipes out others unasked: neither a tree of this name nor a parameter above it (409)."""
        if isinstance(before, dict) and before and not isinstance(value, dict):
            raise Problem(
                409, f"{self.name} is a tree of parameters; DELETE {self._tree_url()} before, or choose a name."
            )
        parts = names.segments(self.name)
        for depth in range(1, len(parts)):
            above = names.join(parts[:depth])
            if above in self.robot.graph.parameters:
                raise Problem(
                    409, f"{above} is a parameter with a value, so nothing can lie below it; DELETE it before."
                )

    async def patch(self, exchange: Exchange) -> Answer:
        before = await self._value()
        if before is None:
            raise Problem(404, f"There is no parameter {self.name}; PUT makes it.")
        data = await exchange.body()
        if exchange.media_type == MERGE_PATCH:
            value = lower_json(merge_patch(parse_json(parameter_json(before)), parse_json(data)))
        else:
            document = parameter_document(self.name, before, self.robot.space)
            value = lower_parameter(updated(data, document.triples, self.url), self.url)
        self._check_place(value, before)
        await self._set({self.name: value})
        return Response(status_code=204)


class ParameterTree(_Parameters):
    """A namespace of parameters: a container, and as plain JSON the object of its members' values."""

    kind = "Parameters"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON), "PATCH": (MERGE_PATCH,)}

    def __init__(self, robot: Robot, namespace: tuple[str, ...]) -> None:
        super().__init__(robot, names.join(namespace), robot.space.container("parameters", namespace))
        self.namespace = namespace

    def methods(self) -> frozenset[str]:
        if not self.robot.adapter.capabilities.parameter_trees:
            return READ
        methods = READ
        if self._can(Operation.SET_PARAMETER) or (not self.namespace and self._may_create()):
            methods |= {"POST", "PATCH"}
        if self.namespace and self._can(Operation.DELETE_PARAMETER):
            methods |= {"DELETE"}
        return methods

    def _may_create(self) -> bool:
        allowed = self.robot.adapter.allows(Ref(Kind.PARAMETER, "/rosld"))
        return Operation.SET_PARAMETER in allowed and not self.robot.settings.read_only

    async def state(self) -> State:
        value = await self._value()
        if value is None and not self.namespace:
            value = {}
        if not isinstance(value, dict):
            raise Problem(404, f"There is no tree of parameters {self.name}.")
        plain = self._plain(value)
        tree = value
        return self.robot.states.get(
            self.url,
            plain,
            lambda: State(
                lambda: parameter_container_document(self.namespace, tree, self.robot.space),
                lambda: plain,
                digest(plain),
            ),
        )

    async def post(self, exchange: Exchange) -> Answer:
        """A new member, named by Slug where it is free (LDP 5.2.3.10)."""
        if self.namespace and await self._value() is None:
            raise Problem(404, f"There is no tree of parameters {self.name}.")
        member = ParameterResource(self.robot, await self._free_name(exchange.header("slug")))
        return await member.put(exchange)

    async def _free_name(self, slug: str | None) -> str:
        kept = "".join(char if char.isalnum() or char == "_" else "_" for char in (slug or "")[:_MOST_SLUG])
        name = names.join((*self.namespace, kept or f"parameter_{secrets.token_hex(3)}"))
        deadline = self.robot.deadline(self.robot.settings.call_deadline)
        taken = await self.robot.adapter.get_parameters([name], deadline=deadline)
        return f"{name}_{secrets.token_hex(3)}" if taken else name

    async def patch(self, exchange: Exchange) -> Answer:
        """Merge patch: members are set, those that are null are deleted."""
        before = await self._value()
        patch = parse_json(await exchange.body())
        if not isinstance(patch, dict) or not isinstance(before, dict | None):
            raise Problem(422, f"A patch of the tree {self.name} is a JSON object of its members.")
        merged = lower_json(merge_patch(parse_json(parameter_json(before or {})), patch))
        assert isinstance(merged, dict)
        gone = [name for name in (before or {}) if name not in merged]
        changed = {name: value for name, value in merged.items() if not _same((before or {}).get(name), value)}
        prefix = "" if self.name == "/" else self.name
        await self._set({f"{prefix}/{name}": value for name, value in changed.items()})
        if gone:
            await self._delete([f"{prefix}/{name}" for name in gone])
        return Response(status_code=204)


def _below(name: str, robot: Robot) -> list[str]:
    """The parameters that lie in a tree now."""
    prefix = name.rstrip("/") + "/"
    return [each for each in robot.graph.parameters if each.startswith(prefix)]


def _leaves(name: str, value: ParameterValue) -> Iterator[str]:
    """The parameters that a value comes to."""
    if not isinstance(value, dict):
        yield name
        return
    for key, inner in value.items():
        yield from _leaves(f"{name.rstrip('/')}/{key}", inner)


def _related(one: str, other: str) -> bool:
    """Whether two names are the same, or one is a tree that holds the other."""
    ones, others = one.rstrip("/") + "/", other.rstrip("/") + "/"
    return ones.startswith(others) or others.startswith(ones)


def _same(one: ParameterValue | None, other: ParameterValue) -> bool:
    """Whether two values are written alike: 1, 1.0 and true are three."""
    return one is not None and parameter_json(one) == parameter_json(other)
