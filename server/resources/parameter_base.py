"""Base of parameters and of their containers, which are read whole or in pages (LDP 5)."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from functools import partial

from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Descriptor, Graph, Kind, Parameter, ParameterValue, names
from rosld.ontology.document import Document
from rosld.ontology.parameters import Outline, parameter_container_document, parameter_json
from rosld.ontology.urls import Space, encode_segment
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_tree
from rosld.server.html.page import MemberColumns
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.resources.base import Services
from rosld.server.resources.named_resource import NamedResource
from rosld.server.resources.namespaces import ListedNamespace, NamespaceBase, count_members, is_of_hidden, with_hidden
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.paging import MAX_PAGE_SIZE, LdpPage, PagePosition, page_of_names
from rosld.server.rest.resource import Answer, ShownAnswer
from rosld.server.rest.state import State
from rosld.server.robot.audited_adapter import has_other_values
from rosld.server.robot.write_policy import parameter_denied_reason, resources_only_reason
from rosld.server.runtime.tasks import call_every, combine_watches, loop_time


def omit_parameters(name: str, tree: dict[str, ParameterValue], omitted: Container[str]) -> dict[str, ParameterValue]:
    """Return the tree of a name without these parameters, and without trees that become empty.

    If nothing is omitted, the result is the same object, which is cheaper to recognize than equal values.
    """
    readable: dict[str, ParameterValue] = {}
    for key, value in tree.items():
        path = f"{name.rstrip('/')}/{key}"
        shown = omit_parameters(path, value, omitted) if isinstance(value, dict) else value
        if path not in omitted and (shown is value or shown):
            readable[key] = shown
    return tree if len(readable) == len(tree) and all(readable[key] is tree[key] for key in tree) else readable


def names_below(name: str, graph: Graph) -> list[str]:
    """Return the names of the current parameters in the tree of this name, at any depth."""
    prefix = name.rstrip("/") + "/"
    return [each for each in graph.parameters if each.startswith(prefix)]


def leaf_values(name: str, value: ParameterValue) -> Iterator[tuple[str, ParameterValue]]:
    """Yield the names and values of the parameters in a value written at `name`: its leaves, or itself if no tree."""
    if not isinstance(value, dict):
        yield name, value
        return
    for key, inner in value.items():
        yield from leaf_values(f"{name.rstrip('/')}/{key}", inner)


def leaf_names(name: str, value: ParameterValue) -> Iterator[str]:
    """Return the names of the parameters in a value written at `name`."""
    return (leaf for leaf, _ in leaf_values(name, value))


def changed_values(
    before: Mapping[str, ParameterValue], after: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the values in `after` that are new or differ from `before`; 1, 1.0 and true all differ."""
    return {
        name: value
        for name, value in after.items()
        if name not in before or parameter_json(before[name]) != parameter_json(value)
    }


def overlaps(one: str, other: str) -> bool:
    """Whether two names are equal or one is a namespace of the other."""
    ones, others = one.rstrip("/") + "/", other.rstrip("/") + "/"
    return ones.startswith(others) or others.startswith(ones)


_LOOK_AGAIN_SECONDS = 1.0
"""Seconds between reads of a watched parameter, because not every kind of robot reports all changes."""


class ParameterBase(NamedResource[Parameter]):
    """Base class of parameters and trees of parameters."""

    shape = "Parameter"
    constraint = "limits"
    is_found_by_state = True
    ros_kind = Kind.PARAMETER
    url_of = Space.parameter
    is_absent = False

    def deny_reason(self, method: str) -> str:
        system = self.session.adapter.capabilities.system
        return self.closed_reason or f"The parameters of this {system} do not support {method} here."

    @property
    def changes_subtree(self) -> bool:
        return bool(names_below(self.name, self.session.graph))

    async def _value(self) -> ParameterValue | None:
        deadline = loop_time() + self.session.settings.call_deadline
        return (await self.session.adapter.get_parameters([self.name], deadline=deadline)).get(self.name)

    def _plain(self, value: ParameterValue) -> bytes:
        """Return the value as plain JSON. Raises a 406 Problem for a too deeply nested value."""
        try:
            return parameter_json(value)
        except ValueError as error:
            raise Problem(406, f"{self.name} cannot be shown: {error}.") from error

    async def watch(self, wake: Callable[[], None]) -> Watch:
        changes = self.session.parameter_changes.watch(wake, lambda name: overlaps(name, self.name))
        return combine_watches(changes, call_every(_LOOK_AGAIN_SECONDS, wake))

    async def _require_settable(self, values: Mapping[str, ParameterValue]) -> None:
        """Raise a Problem or a LoweringError if a value must not be set."""
        graph = self.session.graph
        for name, value in values.items():
            self._require_open(graph, name, value)
            for each in leaf_names(name, value):
                require_not_fixed(graph, each)
            await self.limit_checks.require_parameter(name, value)

    async def _set(self, values: Mapping[str, ParameterValue]) -> None:
        await self._require_settable(values)
        deadline = loop_time() + self.session.settings.call_deadline
        try:
            await self.session.adapter.set_parameters(values, deadline=deadline)
        finally:
            self._announce(values)

    async def _answer(self, requested: Mapping[str, ParameterValue]) -> Answer:
        """Return 204, or the representation if a node changed the written value."""
        values = {name: value for each, whole in requested.items() for name, value in leaf_values(each, whole)}
        deadline = loop_time() + self.session.settings.call_deadline
        if await has_other_values(self.session.adapter, values, deadline=deadline):
            return ShownAnswer(self, await self.state())
        return Response(status_code=204)

    async def _delete(self, gone: Sequence[str]) -> None:
        graph = self.session.graph
        for name in gone:
            self._require_open(graph, name, {})
            require_not_fixed(graph, name, delete=True)
        deadline = loop_time() + self.session.settings.call_deadline
        try:
            await self.session.adapter.delete_parameters(gone, deadline=deadline)
        finally:
            self._announce(gone)

    def _announce(self, changed: Iterable[str]) -> None:
        graph = self.session.graph  # read after the write, so that it includes new parameters below the names
        for name in changed:
            for each in (name, *names_below(name, graph)):
                self.session.announce_write(Kind.PARAMETER, each)

    def _require_open(self, graph: Graph, name: str, value: ParameterValue) -> None:
        """Raise a 409 Problem if a tree contains, or would contain, a name that is writable only under /resources/."""
        for each in (name, *names_below(name, graph), *leaf_names(name, value)):
            if self.session.is_resources_only(each):
                raise Problem(409, resources_only_reason(each))

    async def delete(self, exchange: Exchange) -> Answer:
        """Delete the parameter or the whole tree.

        Raises a 409 Problem if the node declares it undeletable, 404 if it does not exist.
        """
        if await self._value() is None:
            raise Problem(404, f"There is no parameter {self.name}.")
        await self._delete([self.name])
        return Response(status_code=204)


def descriptor_of(graph: Graph, name: str) -> Descriptor | None:
    """Return the declaration of a parameter."""
    parameter = graph.parameters.get(name)
    return None if parameter is None else parameter.descriptor


def require_not_fixed(graph: Graph, name: str, *, delete: bool = False) -> None:
    """Raise a 409 Problem if the node of a parameter declares that it cannot be set (or deleted)."""
    words = parameter_denied_reason(graph, name, delete=delete)
    if words is not None:
        raise Problem(409, words)


_TRIPLES_BYTES = 40
"""Approximate bytes of N-Triples per byte of plain JSON of a tree."""


class ParameterContainer(NamespaceBase, ParameterBase):
    """A readable namespace of parameters: a container in RDF, an object of its members' values in plain JSON.

    A container with many members is paged; the object is paged only on request. Both omit parameters of hidden nodes
    by default.
    """

    kind = "Parameters"
    route = "parameters"

    def __init__(self, services: Services, namespace: tuple[str, ...]) -> None:
        ParameterBase.__init__(self, services, names.join(namespace))
        self.url = services.space.container("parameters", namespace)
        self.namespace = namespace

    async def state(self) -> State:
        return self.state_of(await self._value())

    def state_of(self, value: ParameterValue | None) -> State:
        """Return the state with this value. Raises a 404 Problem if the value is not a tree."""
        if value is None and not self.namespace:
            value = {}
        if not isinstance(value, dict):
            raise Problem(404, f"There is no tree of parameters {self.name}.")
        tree = self._list(value)
        whole = with_hidden(self.url) if tree is not value else None
        plain = self._plain(tree)
        if self._place is not None:
            return self._page_shown(self._place, tree, plain)
        return self.states.get_or_make(
            self._sequence,
            (plain, whole),
            lambda: State(
                partial(parameter_container_document, self.namespace, tree, self.space, MAX_PAGE_SIZE, whole=whole),
                lambda: plain,
                digest(plain),
                weight=_TRIPLES_BYTES * len(plain),
            ),
        )

    def outline(self) -> Document:
        """Return the document without values."""
        listed = self._listed()
        return parameter_container_document(
            self.namespace,
            _outline(listed),
            self.space,
            MAX_PAGE_SIZE,
            whole=with_hidden(self.url) if listed.leaves_out else None,
        )

    def _list(self, value: dict[str, ParameterValue]) -> dict[str, ParameterValue]:
        """Return the tree without hidden parameters; the same object if nothing is omitted."""
        capabilities = self.session.adapter.capabilities
        if self._hidden or not capabilities.hidden_names or names.is_hidden(self.name):
            return value
        hidden = {each.name for each in self.session.graph.parameters.values() if is_of_hidden(each)}
        return omit_parameters(self.name, value, hidden) if hidden else value

    def _page_shown(self, place: PagePosition, tree: Mapping[str, ParameterValue], whole: bytes) -> State:
        page, held = self._page(place, tree)

        def make() -> State:
            return State(
                lambda: page.add_to(parameter_container_document(self.namespace, held, self.space, MAX_PAGE_SIZE)),
                lambda: self._plain(held),
                digest(whole),
                part=page.part,
                headers=page.headers(self.links),
            )

        return self.states.get_or_make(page.url, whole, make)

    def _page(
        self, place: PagePosition, tree: Mapping[str, ParameterValue]
    ) -> tuple[LdpPage, dict[str, ParameterValue]]:
        """Return a page, and its part of the tree."""
        keys = {encode_segment(key) + ("/" if isinstance(tree[key], dict) else ""): key for key in tree}
        page, names = page_of_names(self._sequence, place, sorted(keys))
        return page, {keys[end]: tree[keys[end]] for end in names}

    def listing(self) -> MemberColumns | None:
        members = self._listed().members
        return None if self._place is None or members is None else MemberColumns(total=count_members(members))

    def redact(self, state: State, permissions: Permissions) -> State:
        plain = state.plain
        assert plain is not None
        return state.redact(permissions, plain=lambda: redact_tree(plain(), self.url, permissions))


def _outline(listed: ListedNamespace) -> Outline:
    """Return the members of a namespace and of all below it, without values."""
    members = listed.members
    if members is None:
        return {}
    below = {each: _outline(replace(listed, namespace=(*listed.namespace, each))) for each in members.namespaces}
    return {**dict.fromkeys(members.leaves), **below}
