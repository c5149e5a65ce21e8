"""Complex resources.

`/resources/NS/` joins the values of its members and offers what may be done now (paper, section 4.3; Listing 3).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from msgspec.structs import replace
from pyoxigraph import Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.body import index_triples, parse_json
from rosld.ontology.document import Document
from rosld.server.auth.permissions import Permissions
from rosld.server.html.forms import Form
from rosld.server.html.offer import forms_of
from rosld.server.http.fields import Link
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.hypermedia.affordance_service import Snapshot
from rosld.server.hypermedia.catalogue import Property
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import Json, JsonSchema, MessageSchemas, nullable, patch_schema
from rosld.server.hypermedia.resource_tree import ComplexPlan, ResourceTree
from rosld.server.hypermedia.thing_description import MEDIA_TYPE
from rosld.server.hypermedia.value import shape_url
from rosld.server.hypermedia.view_documents import complex_document, complex_json
from rosld.server.hypermedia.views import ComplexView
from rosld.server.patches.patch import apply_update
from rosld.server.resources.memento import PAST, PastReadings, TimeGate
from rosld.server.resources.property_writes import (
    MemberChange,
    carry_out_all,
    changes_in_graph,
    changes_in_json,
    plan_changes,
    read_fresh_state,
)
from rosld.server.resources.things import FORMAT as TD
from rosld.server.resources.things import wants_thing
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, MERGE_PATCH, OFFERS, SPARQL_UPDATE
from rosld.server.rest.path_item import FORMAT, PART_QUERY, PathItem, WriteMethod
from rosld.server.rest.resource import (
    ABSENT,
    BASIC_CONTAINER,
    RDF_SOURCE,
    READ,
    RESOURCE,
    Answer,
    Plan,
    RobotWrite,
    permanent_redirect,
)
from rosld.server.rest.state import State

_MANY_MEMBERS = 40
"""Number of members from which messages are described only at their own URLs: hundreds of them take megabytes."""
_FORMAT = replace(FORMAT, schema={"type": "string", "enum": [*FORMATS, TD]})


class ComplexResource(TimeGate):
    """A complex resource: a namespace, or a path described by a mapping."""

    kind = "Complex resource"
    shape = "ComplexResource"
    constraint = "limits"
    accepts: Mapping[str, Sequence[str]] = {"PATCH": (MERGE_PATCH, SPARQL_UPDATE)}

    def _own_links(self) -> tuple[Link, ...]:
        thing = Link(f"{self.url}?format={TD}", "describedby", type=MEDIA_TYPE)
        return (RESOURCE, RDF_SOURCE, BASIC_CONTAINER, thing)

    @property
    def also_changes(self) -> Sequence[str]:
        tree = self.affordances.cached_tree() or self.affordances.last_tree
        plan = None if tree is None else tree.complex(self.name)
        return () if plan is None else [url_of(one.url_name or one.source.name, self.space) for one in plan.members]

    async def prepare(self) -> None:
        await self._plan()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        offers, tree = self.affordances, self.affordances.cached_tree() or self.affordances.last_tree
        plan = None if tree is None else tree.complex(self.name)
        read: dict[str, Json] = {}
        sent: dict[str, Json] = {}
        members: dict[str, str] = {}
        described = () if plan is None else plan.members
        for one in described:
            shown = offers.member_affordance(one, write=True)
            value, accepted = schemas.value(shown.shape), schemas.value(shown.shape, sent=True)
            if len(described) > _MANY_MEMBERS and "properties" in value:
                value = accepted = {"type": "object", "description": f"As at {shown.url}."}
            members[one.name], read[one.name] = shown.url, nullable(value)
            if offers.is_writable(one.source):
                sent[one.name] = patch_schema(accepted)
        patch: JsonSchema = {"type": "object", "properties": sent, "additionalProperties": False}
        return PathItem(
            f"The resource {self.name}",
            (*OFFERS, MEDIA_TYPE),
            {"type": "object", "properties": read},
            (_FORMAT, *PAST, *(replace(one, about=f"For Thing Descriptions. {one.about}") for one in PART_QUERY)),
            {"PATCH": WriteMethod("Sets some members.", patch, done=(200, 204))},
            members=members,
        )

    def methods(self) -> frozenset[str]:
        tree = self.affordances.cached_tree()
        plan = tree.complex(self.name) if tree is not None else None
        if plan is None or self.session.settings.read_only:
            return READ
        return READ | {"PATCH"} if any(self.affordances.is_writable(one.source) for one in plan.members) else READ

    async def current_methods(self) -> frozenset[str]:
        """Return the current methods; none for a missing resource, where reads and writes are 404."""
        tree, plan = await self._plan()
        (exists,) = await self.affordances.conditions_hold(tree, plan.reads, plan.exists_when)
        return self.methods() if exists else ABSENT

    def deny_reason(self, method: str) -> str:
        if self.session.settings.read_only:
            return READ_ONLY
        if method == "PATCH":
            return f"No member of {self.name} can be written now."
        return f"A complex resource is read with GET and written with PATCH; it does not support {method}."

    async def state(self) -> State:
        tree, plan = await self._plan()
        return await self.affordances.cached_state(
            self.url, tree, plan.reads, lambda snapshot: self._state_of(plan, snapshot)
        )

    def outline(self, tree: ResourceTree) -> State | None:
        """Return the state without the members' values, or None if the affordances depend on values."""
        plan = tree.complex(self.name)
        if plan is None or plan.is_conditional:
            return None
        return self._state_of(plan, self.affordances.unread(tree, plan.reads))

    async def state_with(self, names: frozenset[str]) -> State:
        """Return the state with the values of only some members, by the names of their properties."""
        tree, plan = await self._plan()
        reads = [one for one in plan.reads if one.name in names]
        unread = self.affordances.unread(tree, plan.reads)

        def make(snapshot: Snapshot) -> State:
            return self._state_of(plan, replace(unread, readings={**unread.readings, **snapshot.readings}))

        return await self.affordances.cached_state(f"{self.url}#{' '.join(sorted(names))}", tree, reads, make)

    def _state_of(self, plan: ComplexPlan, snapshot: Snapshot) -> State:
        view = self.affordances.complex_view(plan, snapshot)
        own = tuple(member.reading for member in view.members)
        times = [one.read_ns for one in own if one.read_ns is not None and one.fresh_until is not None]
        shapes = (shape_url(member.reading, member.field, self.space) for member in view.members)
        return State(
            partial(self._document, view),
            lambda: complex_json(view, self.session.lifting),
            received_ns=min(times, default=None),
            max_age=0 if plan.is_conditional else self.affordances.max_age(own),
            view=view,
            headers=self._headers,
            shapes=tuple(dict.fromkeys(url for url in shapes if url is not None)),
        )

    async def past_state(self, readings: PastReadings) -> State:
        _, plan = await self._plan()
        snapshot, plan = await readings.snapshot(plan.reads), replace(plan, exists_when=())
        view = self.affordances.complex_view(plan, snapshot)
        members = tuple(
            replace(each, affordance=replace(each.affordance, write=False, observe=False)) for each in view.members
        )
        view = replace(view, members=members, actions=())
        return replace(
            self._state_of(plan, snapshot),
            describe=partial(self._document, view),
            plain=lambda: complex_json(view, self.session.lifting),
            view=view,
        )

    async def recorded_properties(self) -> Sequence[Property]:
        _, plan = await self._plan()
        return [each.source for each in plan.members]

    def _document(self, view: ComplexView) -> Document:
        simulated = self.session.graph.simulated_time
        return complex_document(view, self.space, self.session.lifting, simulated_time=simulated)

    def redact(self, state: State, permissions: Permissions) -> State:
        view = state.view
        assert isinstance(view, ComplexView)
        left = view.redact(permissions)
        return state.redact(
            permissions, partial(self._document, left), lambda: complex_json(left, self.session.lifting)
        )

    async def _plan(self) -> tuple[ResourceTree, ComplexPlan]:
        tree = await self.affordances.tree()
        plan = tree.complex(self.name)
        if plan is not None:
            return tree, plan
        name = self.name[:-1]
        if tree.property(name) is not None or tree.action(name) is not None:
            raise permanent_redirect(url_of(name, self.space))
        raise Problem(404, f"There is no resource {self.name}.")

    async def custom_get(self, exchange: Exchange) -> Response | None:
        if not wants_thing(exchange):
            return None
        _, plan = await self._plan()  # it describes all affordances, even while the resource does not exist
        data = self.services.things.of_complex(plan)
        return self.services.things.response(exchange, self.url, f"{self.url}?format={TD}", data)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        tree = await self.affordances.tree()
        plan = tree.complex(self.name)
        return None if plan is None else await self.affordances.watch(plan.reads, wake)

    async def forms(self) -> Sequence[Form]:
        view = (await self.state()).view
        return () if view is None else forms_of(view)

    async def patch(self, exchange: Exchange) -> Answer:
        """Write several members: plan all of them, carry them out one by one, and report each outcome."""
        tree, plan = await self._plan()
        data = await exchange.body()
        named = tuple(member.source.name for member in plan.members)
        async with self.affordances.lock(tree, self.name, *named, modified=named):
            snapshot = await read_fresh_state(self.affordances, tree, plan.reads)
            changes = self._changes(exchange.media_type, plan, snapshot, data)
            return await carry_out_all(self.session, await plan_changes(self.limit_checks, snapshot, changes))

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        """Plan the writes of the properties that a graph changes; the caller holds the lock of `affected_names`.

        Raises a 403 Problem if the resource is not writable or would be deleted (`triples` None).
        """
        (tree, plan) = await self._plan()
        if "PATCH" not in self.methods() or triples is None:
            raise self.not_allowed("PATCH" if triples is not None else "DELETE", 403)
        snapshot = await read_fresh_state(self.affordances, tree, plan.reads)
        view = self.affordances.complex_view(plan, snapshot)
        body = index_triples(triples)
        writes = await plan_changes(
            self.limit_checks, snapshot, changes_in_graph(body, plan, view, self.session.lifting)
        )

        async def carried_out_all() -> bool:
            await carry_out_all(self.session, writes)
            return True

        return RobotWrite(f"write {', '.join(name for name, _ in writes) or 'nothing'} of {self.name}", carried_out_all)

    def affected_names(self, tree: ResourceTree) -> tuple[str, ...]:
        """Return the names affected by a write of the resource's graph."""
        plan = tree.complex(self.name)
        return (self.name, *(member.source.name for member in plan.members)) if plan is not None else (self.name,)

    def _changes(self, media_type: str, plan: ComplexPlan, snapshot: Snapshot, data: bytes) -> Sequence[MemberChange]:
        view = self.affordances.complex_view(plan, snapshot)
        if media_type == MERGE_PATCH:
            return changes_in_json(parse_json(data), plan, view)
        before = complex_document(view, self.space, self.session.lifting.unelided)
        return changes_in_graph(
            apply_update(data, before.all_triples(), self.url, by_value=True), plan, view, self.session.lifting
        )
