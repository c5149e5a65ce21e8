"""Nodes: their topics, services and actions, and the lifecycles of managed nodes; POST requests a transition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode, Triple
from starlette.responses import Response

from rosld.adapters.model import Graph, Kind, Lifecycle, Node, Operation, Ref, Refused, Transition, TypeRef
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.describe_graph import NodeView, node_document, node_views
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.vocab import ros
from rosld.server.html.forms import ChoiceForm, Form
from rosld.server.http.problem import READ_ONLY, Problem, one_line
from rosld.server.hypermedia.json_schema import TEXT, MessageSchemas
from rosld.server.resources.named_resource import NamedResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, RDF_BODIES
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.robot.write_policy import resources_only_reason
from rosld.server.runtime.dry_run import expect_status
from rosld.server.runtime.tasks import loop_time

TRANSITION = "transition"
"""The member of a JSON body, and field of a form, for the name of a transition."""


class NodeResource(NamedResource[Node]):
    """One node."""

    kind = shape = "Node"
    ros_kind = Kind.NODE
    url_of = Space.node
    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON)}

    def _view_in(self, graph: Graph) -> NodeView:
        self.require(graph)
        return self.with_offers(node_views(graph)[self.name])

    def with_offers(self, found: NodeView) -> NodeView:
        """Return the view of this node with its current offers."""
        lifecycle = found.node.lifecycle
        return found if lifecycle is None else replace(found, offers=self._offers(lifecycle))

    @property
    def lifecycle(self) -> Lifecycle | None:
        """The lifecycle of the node, or None."""
        return self._lifecycle_in(self.session.graph)

    def _lifecycle_in(self, graph: Graph) -> Lifecycle | None:
        found = self.found_in(graph)
        return None if found is None else found.lifecycle

    def _offers(self, lifecycle: Lifecycle) -> bool:
        """Whether a transition can be requested here now."""
        allowed = self.session.adapter.allows(Ref(Kind.NODE, self.name))
        return "POST" in self._methods_with(lifecycle) - self.withheld and Operation.CHANGE_STATE in allowed

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        if "POST" not in self.methods():
            return PathItem(f"The node {self.name}")
        transition = WriteMethod(
            "Makes a managed node perform a lifecycle transition; 409 has its state and the valid transitions.",
            sends={"type": "object", "properties": {TRANSITION: TEXT}, "required": [TRANSITION]},
            done=(200, 204),
        )
        return PathItem(f"The node {self.name}", writes={"POST": transition})

    def methods(self) -> frozenset[str]:
        return self._methods_with(self.lifecycle)

    def _methods_with(self, lifecycle: Lifecycle | None) -> frozenset[str]:
        if self.session.settings.read_only or lifecycle is None or lifecycle.state is None:
            return READ
        return READ if self._closed(lifecycle) else READ | {"POST"}

    def _closed(self, lifecycle: Lifecycle) -> str | None:
        """Return the name that makes the lifecycle writable only under /resources/, or None."""
        return next((name for name in (self.name, lifecycle.service) if self.session.is_resources_only(name)), None)

    def deny_reason(self, method: str) -> str:
        lifecycle = self.lifecycle
        if self.session.settings.read_only:
            return READ_ONLY
        if method != "POST" or lifecycle is None:
            return f"{self.name} has no lifecycle: it does not support {method}."
        name = self._closed(lifecycle)
        return (
            resources_only_reason(name) if name is not None else f"No transition can be requested: {lifecycle.unknown}."
        )

    async def state(self) -> State:
        graph, space = self.session.graph, self.space
        view, simulated = self._view_in(graph), graph.simulated_time
        return self.states.get_or_make(
            self.url, (view, simulated), lambda: State(partial(node_document, view, space, simulated_time=simulated))
        )

    async def forms(self) -> Sequence[Form]:
        lifecycle = self.lifecycle
        if lifecycle is None or not self._offers(lifecycle):
            return ()
        labels = tuple(each.label for each in lifecycle.transitions)
        return (ChoiceForm(TRANSITION, labels, "Change the state"),)

    async def post(self, exchange: Exchange) -> Answer:
        """Request the transition named in the body from a managed node (`lifecycle_msgs/srv/ChangeState`).

        Raises a 409 Problem with the legal transitions if the node refuses it.
        """
        label = await _label_in(exchange, self.url)
        graph = self.session.graph
        lifecycle = self._lifecycle_in(graph)
        transition = next((each for each in lifecycle.transitions if each.label == label), None) if lifecycle else None
        if transition is not None and lifecycle is not None:
            await self._require(graph, transition, lifecycle.service)
        try:
            deadline = loop_time() + self.session.settings.call_deadline
            expect_status(204)
            await self.session.adapter.change_state(self.name, label, deadline=deadline)
        except Refused as error:
            raise self._refusal(error) from error
        finally:
            if lifecycle is not None:
                self.session.announce_write(Kind.SERVICE, lifecycle.service)
        return Response(status_code=204)

    async def _require(self, graph: Graph, transition: Transition, service: str) -> None:
        """Raise LoweringError if the transition violates a limit on this node or on its lifecycle service."""
        shape = self.limit_checks.limits.resource(self.url)
        if shape is not None:
            subject = NamedNode(self.url)
            broken = tuple(shape.violations(subject, [Triple(subject, ros.transition, Literal(transition.label))]))
            if broken:
                raise LoweringError(*broken)
        if self.limit_checks.limits:
            found = graph.services.get(service)
            ref = found.type if found is not None else None
            schema = await self.session.schemas.service(ref or TypeRef("lifecycle_msgs/srv/ChangeState"))
            sent = {"transition": {"id": transition.id, "label": transition.label}}
            message = lowerer(schema.request, self.session.lifting).from_json(sent)
            await self.limit_checks.require_message(Kind.SERVICE, service, schema.request, message)

    def _refusal(self, error: Refused) -> Problem:
        """Return a 409 Problem with the state of the node and the legal transitions."""
        problem = problem_of(error)
        lifecycle = self.lifecycle  # read again: the node may have made another transition meanwhile
        problem.status, problem.title = 409, "Not done"
        if lifecycle is not None:
            problem.extra |= {
                "state": None if lifecycle.state is None else one_line(lifecycle.state.label),
                "transitions": [one_line(each.label) for each in lifecycle.transitions],
            }
        return problem


async def _label_in(exchange: Exchange, url: str) -> str:
    """Return the transition named in a body. Raises BodyError, LoweringError."""
    data = await exchange.body()
    found: Sequence[object]
    if exchange.media_type == JSON:
        content = parse_json(data)
        if not isinstance(content, dict):
            raise LoweringError(Violation("", 'expected an object: {"transition": "activate"}'))
        strange = [Violation(name, "is not accepted by a node") for name in content if name != TRANSITION]
        if strange:
            raise LoweringError(*strange)
        found = [content[TRANSITION]] if TRANSITION in content else []
    else:
        terms = parse_body(data, exchange.media_type, url).objects(NamedNode(url), ros.transition)
        found = [term.value if isinstance(term, Literal) else term for term in terms]
    if len(found) != 1 or not isinstance(found[0], str):
        raise LoweringError(Violation(TRANSITION, "expected the name of one transition, such as activate"))
    return found[0]
