"""Containers of parameters: a tree of them as it is read, whole or in pages (LDP 5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from rosld.adapters.model import ParameterValue, names
from rosld.ontology.document import Document
from rosld.ontology.parameters import Outline, parameter_container_document
from rosld.ontology.urls import encode_segment
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_tree
from rosld.server.html.page import MemberColumns, SequenceLink
from rosld.server.http.conditional import digest
from rosld.server.http.fields import render_links
from rosld.server.http.problem import Problem
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.namespaces import (
    ListedNamespace,
    count_members,
    is_of_hidden,
    listing_query,
    member_keys,
    with_hidden,
)
from rosld.server.resources.parameter_base import ParameterBase, omit_parameters
from rosld.server.rest.paging import MAX_PAGE_SIZE, LdpPage, PagePosition, page_of_names
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache

_TRIPLES_BYTES = 40
"""Bytes of N-Triples, about, that a byte of plain JSON of a tree comes to."""


class ParameterContainer(ParameterBase):
    """A namespace of parameters as it is read: a container, and as plain JSON the object of its members' values.

    Where there are many members the container comes in pages. The object is one value, and never does unasked. Neither
    tells of the parameters of hidden nodes unasked.
    """

    kind = "Parameters"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    _place: PagePosition | None = None
    _hidden = False

    def __init__(
        self,
        session: Session,
        limit_checks: LimitChecks,
        states: VersionCache[State],
        namespace: tuple[str, ...],
    ) -> None:
        super().__init__(session, limit_checks, states, names.join(namespace))
        self.url = session.space.container("parameters", namespace)
        self.namespace = namespace

    @property
    def variant_key(self) -> tuple[PagePosition | None, bool]:
        return self._place, self._hidden

    @property
    def _sequence(self) -> str:
        return with_hidden(self.url) if self._hidden else self.url

    @property
    def query(self) -> str:
        return listing_query(self._place, hidden=self._hidden)

    async def state(self) -> State:
        return self.state_of(await self._value())

    def state_of(self, value: ParameterValue | None) -> State:
        """Return the state with this value. Raises a 404 Problem where it is none of a tree."""
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
        """The tree as it is listed; the same object where nothing is left out."""
        capabilities = self.session.adapter.capabilities
        if self._hidden or not capabilities.hidden_names or names.is_hidden(self.name):
            return value
        hidden = {each.name for each in self.session.graph.parameters.values() if is_of_hidden(each)}
        return omit_parameters(self.name, value, hidden) if hidden else value

    def _listed(self) -> ListedNamespace:
        """The namespace as it is listed in the graph of now."""
        capabilities = self.session.adapter.capabilities
        return ListedNamespace(self.session.graph, capabilities, "parameters", self.namespace, hidden=self._hidden)

    def _page_shown(self, place: PagePosition, tree: Mapping[str, ParameterValue], whole: bytes) -> State:
        page, held = self._page(place, tree)

        def make() -> State:
            return State(
                lambda: page.add_to(parameter_container_document(self.namespace, held, self.space, MAX_PAGE_SIZE)),
                lambda: self._plain(held),
                digest(whole),
                part=f"p{digest(page.token.encode())}",
                headers={"link": render_links([*self.links, *page.links()]), "vary": "Accept, Prefer"},
            )

        return self.states.get_or_make(page.url, whole, make)

    def _page(
        self, place: PagePosition, tree: Mapping[str, ParameterValue]
    ) -> tuple[LdpPage, dict[str, ParameterValue]]:
        """Return a page, and its part of the tree."""
        keys = {encode_segment(key) + ("/" if isinstance(tree[key], dict) else ""): key for key in tree}
        page, told = page_of_names(self._sequence, place, sorted(keys))
        return page, {keys[end]: tree[keys[end]] for end in told}

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        members = self._listed().members
        if self._place is None or members is None:
            return ()
        return page_of_names(self._sequence, self._place, member_keys(members))[0].neighbours()

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
