"""Members of complex resources: properties and actions, `/resources/NS/X` (paper, section 4.2; Listing 2).

A property is read with GET and written with PUT and PATCH, an action is invoked with POST. One name may be both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Kind, ServiceSchema
from rosld.ontology.body import RdfBody, index_triples, parse_body, parse_json
from rosld.ontology.document import Document
from rosld.ontology.fields import field_bytes
from rosld.ontology.vocab import rdf, ros
from rosld.server.html.forms import Form
from rosld.server.html.offer import action_form, cancel_forms, property_form
from rosld.server.http.fields import Link
from rosld.server.http.problem import READ_ONLY, ROBOT_SAID, Problem
from rosld.server.hypermedia.affordance_service import Snapshot
from rosld.server.hypermedia.catalogue import Property
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import ANYTHING, OBJECT, MessageSchemas, nullable, patch_schema
from rosld.server.hypermedia.property_writer import (
    PlannedWrite,
    WriteOutcome,
    carry_out,
    not_writable_about,
    not_writable_reason,
)
from rosld.server.hypermedia.resource_tree import ActionPlan, PropertyPlan, ResourceTree, parent_of
from rosld.server.hypermedia.value import MessageValue, content_from_rdf, shape_url
from rosld.server.hypermedia.view_documents import action_document, property_document, property_json
from rosld.server.hypermedia.views import PropertyView
from rosld.server.patches.patch import apply_update, merge_patch
from rosld.server.resources.accepted_shape import (
    has_property_shape,
    message_shape,
    property_shape,
    require_property_text,
    shape_query,
)
from rosld.server.resources.actions import GOAL_ENDS, ActionResource
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.limit_checks import STRICTNESS, is_strict
from rosld.server.resources.memento import PAST, PastReadings, TimeGate
from rosld.server.resources.property_writes import (
    plan_property_write,
    read_fresh_state,
    require_offered,
    require_writable,
    with_field,
    write_response,
)
from rosld.server.resources.services import ServiceResource, call_problem, refusal_problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import ABSENT, READ, Answer, Plan, Resource, RobotWrite, ShownAnswer, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.calls import CallOutcome
from rosld.server.runtime.dry_run import expect_status

_INVOKES = "Invokes the action; returns the resource that it belongs to."
_SENDS_A_GOAL = "Sends a goal; 409 if it is rejected."
_CANCELS = "Cancels goals sent through rosld."
_OTHERS = QueryParameter("others", "Goals of all clients.", {"type": "boolean"})


class MemberResource(TimeGate):
    """A property, an action, or a name that is both."""

    kind = "Resource"
    accepts: Mapping[str, Sequence[str]] = {
        "PUT": (*RDF_BODIES, JSON),
        "PATCH": (MERGE_PATCH, SPARQL_UPDATE),
        "POST": (*RDF_BODIES, JSON),
    }

    async def prepare(self) -> None:
        tree = await self.affordances.tree()
        if tree.property(self.name) is None and tree.action(self.name) is None:
            raise self._missing(tree)

    @property
    def _plans(self) -> tuple[PropertyPlan | None, ActionPlan | None]:
        """The plans of the property and of the action, if known."""
        tree = self.affordances.cached_tree()
        return (None, None) if tree is None else (tree.property(self.name), tree.action(self.name))

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        plan, action = self._plans
        value = sent = None
        if plan is not None:
            shape = self.affordances.member_affordance(plan.member, write=True).shape
            value, sent = schemas.value(shape), schemas.value(shape, sent=True)
        sends_goals = action is not None and action.sends_goals
        invoke = WriteMethod(
            _SENDS_A_GOAL if sends_goals else _INVOKES,
            schemas.write(action.request if action else None),
            GOAL_ENDS if sends_goals else "With the response: 200 and the new state of the resource.",
            is_body_required=False,
            done=(201,) if sends_goals else (200, 204),
            shows=OBJECT,
            query=STRICTNESS,
        )
        return PathItem(
            f"The {'action' if value is None else 'property'} {self.name}",
            FIELD_READS,
            None if value is None else nullable(value),
            (FORMAT, FIELD, *PAST),
            {
                "DELETE": WriteMethod(_CANCELS, done=(202,), query=(_OTHERS,)),
                "PUT": WriteMethod(
                    "Sets the value.",
                    ANYTHING if sent is None else sent,
                    "At once: 204 if set, 200 with the value if the robot chose another, 202 if no node received it.",
                    done=(200, 202, 204),
                    query=STRICTNESS,
                ),
                "PATCH": WriteMethod(sends=ANYTHING if sent is None else patch_schema(sent), done=(200, 202, 204)),
                "POST": invoke,
            },
            has_shape=self._has_shape,
        )

    def methods(self) -> frozenset[str]:
        """Return the methods for this kind of resource, regardless of conditions (unmet ones are 409)."""
        if self.session.settings.read_only:
            return READ
        methods = READ
        plan, action = self._plans
        if plan is not None and self.affordances.is_writable(plan.source):
            methods |= {"PUT", "PATCH"}
        if action is not None and self.affordances.is_callable(action):
            methods |= {"POST"}
        if action is not None and self.affordances.can_cancel(action):
            methods |= {"DELETE"}
        return methods

    @property
    def withheld(self) -> frozenset[str]:
        """The methods not offered while the robot is stopped: all writes, except canceling goals."""
        return super().withheld - {"DELETE"}

    async def current_methods(self) -> frozenset[str]:
        """Return the current methods: none for a missing resource, only writing ones (which say why) if not offered."""
        tree, methods = await self.affordances.tree(), self.methods()
        plan, action = tree.property(self.name), tree.action(self.name)
        reads = (*(() if plan is None else plan.reads), *(() if action is None else action.reads))
        exists_when = next((each.exists_when for each in (plan, action) if each is not None), ())
        conditions = () if plan is not None or action is None else action.conditions
        exists, offered = await self.affordances.conditions_hold(tree, reads, exists_when, conditions)
        if not exists:
            return ABSENT
        return methods if offered else methods - {"GET", "HEAD"}

    def deny_reason(self, method: str) -> str:
        if self.session.settings.read_only:
            return READ_ONLY
        plan, _ = self._plans
        if plan is not None and method in ("PUT", "PATCH"):
            return not_writable_reason(self.session.adapter, self.session.settings, plan.source)
        return f"{self.name} does not support {method}."

    @property
    def deny_about(self) -> Sequence[str]:
        plan, _ = self._plans
        return () if plan is None else not_writable_about(self.session, plan.source)

    @property
    def constrained_by(self) -> str | None:
        return shape_query(self.url) if self._has_shape else f"{self.url}#property/shape"

    @property
    def _has_shape(self) -> bool:
        """Whether there is a shape for the values that may be written here."""
        plan, action = self._plans
        is_invoked = action is not None and action.request is not None
        return is_invoked or (plan is not None and has_property_shape(self.session, plan))

    async def accepted(self, url: str) -> Document | None:
        tree = await self.affordances.tree()
        action, plan = tree.action(self.name), tree.property(self.name)
        if action is not None and action.request is not None:
            kind = Kind.ACTION if action.sends_goals else Kind.SERVICE
            return await message_shape(self.limit_checks, kind, action.service, action.request, url)
        return None if plan is None else await property_shape(self.limit_checks, plan, self.url, url)

    @property
    def conforms_to(self) -> Sequence[str]:
        plan, action = self._plans
        return (self.space.document_shape("ActionResource" if plan is None and action is not None else "Property"),)

    # Reading

    async def state(self) -> State:
        tree = await self.affordances.tree()
        plan = tree.property(self.name)
        if plan is not None:
            return await self.affordances.cached_state(
                self.url, tree, plan.reads, lambda snapshot: self._state_of(plan, snapshot)
            )
        action = tree.action(self.name)
        if action is not None:
            return await self.affordances.cached_state(
                self.url, tree, action.reads, lambda snapshot: self._shown_action(action, snapshot)
            )
        raise self._missing(tree)

    def outline(self, tree: ResourceTree) -> State | None:
        """Return the state without the value, or None if the affordances depend on values."""
        plan, action, offers = tree.property(self.name), tree.action(self.name), self.affordances
        if plan is not None:
            return None if plan.is_conditional else self._state_of(plan, offers.unread(tree, plan.reads))
        if action is None or action.exists_when or action.conditions:
            return None
        return self._shown_action(action, offers.unread(tree, action.reads))

    def _state_of(self, plan: PropertyPlan, snapshot: Snapshot) -> State:
        view = self.affordances.property_view(plan, snapshot)
        shape = shape_url(view.reading, view.field, self.space)
        return State(
            partial(self._document, view),
            lambda: property_json(view, self.session.lifting),
            received_ns=view.reading.read_ns,
            max_age=0 if plan.is_conditional else self.affordances.max_age((view.reading,)),
            view=view,
            headers=self._headers,
            shapes=() if shape is None else (shape,),
        )

    async def past_state(self, readings: PastReadings) -> State:
        plan = (await self.affordances.tree()).property(self.name)
        if plan is None:
            raise Problem(404, f"{self.name} is an action, and actions are not recorded.")
        snapshot, plan = await readings.snapshot(plan.reads), replace(plan, exists_when=())
        view = self.affordances.property_view(plan, snapshot)
        view = replace(view, affordance=replace(view.affordance, write=False, observe=False))
        return replace(
            self._state_of(plan, snapshot),
            describe=partial(self._document, view),
            plain=lambda: property_json(view, self.session.lifting),
            view=None,
        )

    async def recorded_properties(self) -> Sequence[Property]:
        plan = (await self.affordances.tree()).property(self.name)
        return () if plan is None else (plan.source,)

    def _document(self, view: PropertyView) -> Document:
        simulated = self.session.graph.simulated_time
        return property_document(view, self.space, self.session.lifting, simulated_time=simulated)

    def _shown_action(self, plan: ActionPlan, snapshot: Snapshot) -> State:
        view = self.affordances.action_view(plan, snapshot)
        return State(lambda: action_document(view, self.space), view=view, headers=self._headers)

    def _missing(self, tree: ResourceTree) -> Problem:
        """Return a 308 redirect to the resource that a mapping names otherwise, else a 404 Problem."""
        found = tree.redirect_target(self.name)
        if found is not None:
            return permanent_redirect(url_of(found, self.space))
        return Problem(404, f"There is no resource {self.name}.")

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        tree = await self.affordances.tree()
        plan = tree.property(self.name) or tree.action(self.name)
        return None if plan is None else await self.affordances.watch(plan.reads, wake)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        return await self.get_part(self, exchange)

    async def get_part(self, resource: Resource, exchange: Exchange) -> Response | None:
        """Return one field of the value for `?field=PATH`, else None. Raises a 404 Problem for a missing field."""
        if b"field=" not in exchange.request.scope["query_string"] or "field" not in exchange.query:
            return None
        view, path = (await resource.state()).view, exchange.query["field"]
        value = view.reading.value if isinstance(view, PropertyView) else None
        if not isinstance(value, MessageValue):
            raise Problem(404, f"{self.name} has no message, so no field {path!r}.")
        try:
            data, media_type = field_bytes(value.schema, value.message, path)
        except ValueError as error:
            raise Problem(404, str(error)) from error
        return Response(data, media_type=media_type, headers={"Cache-Control": "no-cache"})

    async def forms(self) -> Sequence[Form]:
        """Return the forms regardless of conditions, so that a form of an older page gets the reason for a refusal."""
        tree, offers = await self.affordances.tree(), self.affordances
        forms: list[Form] = []
        if tree.property(self.name) is not None:
            view = (await self.state()).view
            if isinstance(view, PropertyView):
                forms.append(property_form(view.affordance, view.reading))
        action = tree.action(self.name)
        if action is None:
            return forms
        affordance = offers.action_affordance(action)
        form = action_form(affordance)
        return [*forms, *(() if form is None else (form,)), *cancel_forms(affordance)]

    # Writing

    async def put(self, exchange: Exchange) -> Answer:
        """Write the property through the topic, service or parameter of its mapping or convention.

        Returns 200 with the value if the robot changed it, 202 without a subscriber, else 204.
        """
        tree, plan = await self._property()
        content = await self._content(exchange, plan, await exchange.body())
        changed = () if plan.member.field is None else (plan.source.name,)
        async with self.affordances.lock(tree, self.name, modified=changed):
            written = await self._write(tree, plan, content, defaults=not is_strict(exchange))
            return await self._answer(exchange, written)

    async def _answer(self, exchange: Exchange, planned: PlannedWrite) -> Answer:
        """Carry out a write and return the response, which has the value if it differs from the requested one."""
        expect_status(204)
        written = await carry_out(self.session, planned)
        if written is WriteOutcome.OTHERWISE:
            return ShownAnswer(self, await self.state())
        return write_response(exchange, self.space, planned, written)

    async def _write(
        self, tree: ResourceTree, plan: PropertyPlan, content: object, *, defaults: bool = False
    ) -> PlannedWrite:
        """Plan the write of a value if conditions allow it; sends nothing to the robot."""
        if plan.is_conditional or plan.member.field is not None:
            snapshot = await read_fresh_state(self.affordances, tree, plan.reads)
            require_writable(self.affordances, plan, snapshot)
            content = self._whole(plan, snapshot, content)
        return await plan_property_write(self.limit_checks, plan.source, content, defaults=defaults)

    async def plan_graph_write(self, triples: Sequence[Triple] | None) -> Plan:
        """Plan the write of the property by a graph; the caller holds the lock of `affected_names`.

        Raises a 403 Problem if the property is not writable or would be deleted (`triples` None).
        """
        tree, plan = await self._property()
        if "PUT" not in self.methods():
            raise self.not_allowed("PUT", 403)
        if triples is None:
            raise Problem(403, f"{self.name} exists as long as the robot has it: it cannot be deleted.")
        body = index_triples(triples)
        written = await self._write(tree, plan, await self._content_of(plan, body))

        async def carried_out() -> bool:
            return await carry_out(self.session, written) is not WriteOutcome.UNHEARD

        return RobotWrite(f"write {self.name}", carried_out)

    def affected_names(self, tree: ResourceTree) -> tuple[str, ...]:
        """Return the names affected by a write of the resource's graph."""
        plan = tree.property(self.name)
        return (self.name,) if plan is None else (self.name, plan.source.name)

    async def patch(self, exchange: Exchange) -> Answer:
        """Write the patched current value; a lock excludes other writes by this server between read and write."""
        tree, plan = await self._property()
        data = await exchange.body()
        async with self.affordances.lock(tree, self.name, modified=(plan.source.name,)):
            snapshot = await read_fresh_state(self.affordances, tree, plan.reads)
            require_writable(self.affordances, plan, snapshot)
            content = self._whole(plan, snapshot, await self._patch(exchange, plan, snapshot, data))
            written = await plan_property_write(self.limit_checks, plan.source, content)
            return await self._answer(exchange, written)

    async def _property(self) -> tuple[ResourceTree, PropertyPlan]:
        tree = await self.affordances.tree()
        plan = tree.property(self.name)
        if plan is None:
            raise self._missing(tree)
        return tree, plan

    def _whole(self, plan: PropertyPlan, snapshot: Snapshot, content: object) -> object:
        """Return the content of the whole property if the member is one field of it."""
        field = plan.member.field
        return (
            content
            if field is None
            else with_field(plan.source, snapshot.readings[plan.source.name], self.name, field, content)
        )

    async def _content(self, exchange: Exchange, plan: PropertyPlan, data: bytes) -> object:
        if exchange.media_type == JSON:
            return parse_json(data)
        return await self._content_of(plan, parse_body(data, exchange.media_type, self.url))

    async def _content_of(self, plan: PropertyPlan, body: RdfBody) -> object:
        """Return the value in RDF: the object of rdf:value or of the mapping's predicate."""
        subject, predicate = NamedNode(self.url), rdf.value
        home = NamedNode(url_of(plan.parent, self.space))
        if plan.mapped is not None and body.objects(home, plan.mapped.predicate):
            subject, predicate = home, plan.mapped.predicate
        await require_property_text(self.limit_checks, plan, body, subject, predicate)
        return content_from_rdf(body, subject, predicate, plan.source, self.session.lifting)

    async def _patch(self, exchange: Exchange, plan: PropertyPlan, snapshot: Snapshot, data: bytes) -> object:
        view = self.affordances.property_view(plan, snapshot)
        if view.reading.value is None:
            why = view.reading.failure or "it has no value yet"
            detail = f"{self.name} cannot be patched: {why}; PUT a whole value."
            raise Problem(409, detail, extra={ROBOT_SAID: view.reading.words}, about=view.reading.about)
        if exchange.media_type == MERGE_PATCH:
            return merge_patch(parse_json(property_json(view, self.session.lifting.unelided)), parse_json(data))
        before = property_document(view, self.space, self.session.lifting.unelided)
        return await self._content_of(plan, apply_update(data, before.all_triples(), self.url, by_value=True))

    async def post(self, exchange: Exchange) -> Answer:
        """Invoke the action: call its service, or send its goal.

        Raises a 409 Problem if a condition does not hold.
        """
        tree = await self.affordances.tree()
        plan = tree.action(self.name)
        if plan is None:
            raise self._missing(tree)
        if plan.sends_goals:
            return await self._send_goal(exchange, tree, plan)
        if not isinstance(plan.schema, ServiceSchema):
            raise Problem(409, f"{self.name} cannot be invoked: the type of the service is not known.")
        service = ServiceResource(self.services, plan.service)
        request = await service.read_message(exchange, self.url, plan.schema)
        async with self.affordances.lock(tree, self.name):
            require_offered(self.affordances, plan, await read_fresh_state(self.affordances, tree, plan.reads))
            expect_status(200)
            outcome = await service.call(exchange, plan.schema, request)
        problem = call_problem(self.space, outcome) or refusal_problem(self.space, outcome)
        if problem is not None:
            raise problem
        return await self._after(plan.parent, outcome)

    async def _send_goal(self, exchange: Exchange, tree: ResourceTree, plan: ActionPlan) -> Answer:
        """Send a goal to the ROS action of the mapping and return the created goal."""
        action = ActionResource(self.services, plan.service)
        schema = await action.schema()
        goal = await action.read_message(exchange, self.url, schema)
        async with self.affordances.lock(tree, self.name):
            require_offered(self.affordances, plan, await read_fresh_state(self.affordances, tree, plan.reads))
            return await action.send(exchange, schema, goal)

    async def delete(self, exchange: Exchange) -> Answer:
        """Cancel goals of a ROS action regardless of conditions, with `?others=true` also those of other clients.

        Raises a 404 Problem if there is no such action.
        """
        tree = await self.affordances.tree()
        plan = tree.action(self.name)
        if plan is None:
            raise self._missing(tree)
        return await ActionResource(self.services, plan.service).cancel_goals(others=exchange.query_flag("others"))

    async def _after(self, path: str, outcome: CallOutcome) -> ShownAnswer:
        """Return the complex resource after an action, or the nearest existing ancestor if the action removed it."""
        call = Link(self.space.call(outcome.call.id), ros.Call.value)
        while True:
            resource = ComplexResource(self.services, path)
            try:
                return ShownAnswer(resource, await resource.state(), (call,))
            except Problem as problem:
                above = parent_of(path)
                if problem.status != 404 or above is None:
                    raise
                path = above
