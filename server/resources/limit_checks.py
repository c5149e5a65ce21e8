"""Checks of limits on writes, by message type, by URL, and by the property of the topic, service or parameter.

The constraints that a node declares on a parameter count as limits, and so does the finiteness of command numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import Descriptor, Kind, Message, MessageSchema, ParameterValue
from rosld.ontology.body import RdfBody, Term
from rosld.ontology.lexical import BINARIES
from rosld.ontology.lift import lifter
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Path, Violation, brief_value
from rosld.ontology.vocab import rdf, ros, sh
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.conditions import url_of, value_triples
from rosld.server.hypermedia.json_schema import BOOLEAN
from rosld.server.hypermedia.value import MessageValue, Reading, StoredValue, Value, scalar_field
from rosld.server.policies.active_limits import ActiveLimits
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import QueryParameter
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import any_number_hint, takes_finite_numbers
from rosld.server.runtime.dry_run import note_limits
from rosld.shapes.command_numbers import (
    LARGEST_NUMBER,
    largest_number,
    require_finite_message,
    require_finite_parameter,
)
from rosld.shapes.compiled_shape import component
from rosld.shapes.limit_parts import Demand, ValuePlace, limited_texts
from rosld.shapes.limits import Limits
from rosld.shapes.parameter import declared_demand, violations
from rosld.shapes.value import Bounds, merge_bounds

STRICTNESS = (
    QueryParameter(
        "strict", "Whether to reject JSON with missing fields; otherwise they have their defaults.", BOOLEAN
    ),
    QueryParameter("defaults", "The opposite of `strict` (deprecated).", BOOLEAN),
)


def is_strict(exchange: Exchange) -> bool:
    """Whether a message in JSON must have all its fields: `?strict=true`, or `?defaults=false`, its former name.

    Raises a 400 Problem if the two contradict each other.
    """
    strict = exchange.query_flag("strict")
    if "defaults" not in exchange.query:
        return strict
    if "strict" in exchange.query and exchange.query_flag("defaults") == strict:
        raise Problem(400, "?strict and ?defaults contradict each other: omit ?defaults.")
    return not exchange.query_flag("defaults")


NODES: Mapping[Kind, str] = {Kind.TOPIC: "#message", Kind.SERVICE: "#request", Kind.ACTION: "#goal"}
"""Fragments of the message nodes in RDF bodies sent to a topic, a service or an action."""
_LINKS = {Kind.TOPIC: ros.latest, Kind.SERVICE: ros.request, Kind.ACTION: ros.goalMessage}


def target_url(space: Space, kind: Kind, name: str) -> str:
    """Return the URL of a topic, a service or an action."""
    return {Kind.TOPIC: space.topic, Kind.SERVICE: space.service, Kind.ACTION: space.action}[kind](name)


class LimitChecks:
    """Checks of writes against the current limits on resources and types."""

    def __init__(self, session: Session, affordances: AffordanceService[State], active: ActiveLimits) -> None:
        self.session = session
        self._space = session.space
        self.affordances = affordances
        self._active = active

    @property
    def limits(self) -> Limits:
        """The current limits."""
        return self._active.current

    async def require_message(self, kind: Kind, name: str, schema: MessageSchema, message: Message) -> None:
        """Raise LoweringError if a message to the topic, service or action `name` violates a limit."""
        try:
            require_finite_message(schema, message, any_number_hint(name))
        except LoweringError:
            if self._takes_finite(kind, name, schema.ref.name):
                raise
        limits = self.limits
        if not limits:
            return
        url, node = target_url(self._space, kind, name), NODES[kind]
        check = limits.message(schema)
        if check is not None:
            note_limits(self._space.class_of(schema.ref.name))
        broken = list(check(message, url, node)) if check is not None else []
        shape = limits.resource(url)
        if shape is not None:
            note_limits(url)
            link = Triple(NamedNode(url), _LINKS[kind], NamedNode(url + node))
            broken += shape.violations(
                NamedNode(url), [link, *lifter(schema, self.session.lifting).triples(message, url, node)]
            )
        own = MessageValue(schema, message, schema.type.fields, url)
        broken += await self._of_property(kind, name, own)
        if broken:
            raise LoweringError(*broken)

    async def require_text(self, kind: Kind, name: str, schema: MessageSchema, body: RdfBody) -> None:
        """Raise LoweringError if a body writes a limited text as octets."""
        if not self.limits or not any(each.datatype in BINARIES for each in body.literals()):
            return
        require_no_octets(body, limited_texts(await self.message_demand(kind, name, schema), schema, self._space))

    async def message_demand(self, kind: Kind, name: str, schema: MessageSchema) -> Demand:
        """Return the combined demand of all limits on a message sent to `name`."""
        limits = self.limits
        demand = Demand(largest=largest_number(schema) if self._takes_finite(kind, name, schema.ref.name) else None)
        if not limits:
            return demand
        scalar = scalar_field(schema.type.fields)
        demand &= limits.demand_of_message(schema) & limits.demand_of_value(
            target_url(self._space, kind, name), _LINKS[kind], schema
        )
        for shown, field in await self._property_names(kind, name):
            if field is None:
                demand &= limits.demand_of_value(shown, rdf.value, schema, None if scalar is None else scalar.name)
            else:
                own = limits.demand_of_scalar(shown, rdf.value, ValuePlace.of_field(schema, field))
                is_all = own.is_all and not any(step.isdecimal() for step in field.split("."))
                parts = tuple((field, part) for _, part in own.value_parts)
                demand &= Demand(tuple((field, bounds) for _, bounds in own.bounds), is_all, parts)
        return demand

    async def parameter_demand(self, name: str, descriptor: Descriptor) -> Demand:
        """Return the combined demand of the node and all limits on a parameter that is declared as a scalar."""
        limits, demand = self.limits, declared_demand(descriptor)
        demand = replace(demand, largest=LARGEST_NUMBER if self._takes_finite(Kind.PARAMETER, name) else None)
        if not limits:
            return demand
        place = None if descriptor.type is None else ValuePlace(descriptor.type)
        demand &= limits.demand_of_scalar(self._space.parameter(name), ros.value, place)
        for shown, _ in await self._property_names(Kind.PARAMETER, name):
            demand &= limits.demand_of_scalar(shown, rdf.value, place)
        return demand

    async def message_bounds(self, kind: Kind, name: str, schema: MessageSchema) -> Mapping[str, Bounds]:
        """Return the bounds of single fields of a message sent to `name`, by path."""
        demand = await self.message_demand(kind, name, schema)
        return merge_bounds(*({path: bounds} for path, bounds in demand.bounds))

    async def require_parameter(self, name: str, value: ParameterValue) -> None:
        """Raise LoweringError if a parameter, or one in a tree, violates limits or its declaration."""
        self._require_finite_parameter(name, value)
        broken = self._declaration_violations(name, value)
        if self.limits and not broken:
            broken = await self._of_parameter(name, value)
        if broken:
            raise LoweringError(*broken)

    def _takes_finite(self, kind: Kind, name: str, type: str = "") -> bool:
        return takes_finite_numbers(self.session.graph, self.session.settings.allow_non_finite, kind, name, type)

    def _require_finite_parameter(self, name: str, value: ParameterValue, path: Path = None) -> None:
        """Raise LoweringError if a float in a parameter or tree is not finite or too large."""
        if isinstance(value, dict):
            for key, each in value.items():
                self._require_finite_parameter(f"{name.rstrip('/')}/{key}", each, (path, key))
        elif self._takes_finite(Kind.PARAMETER, name):
            require_finite_parameter(value, path, any_number_hint(name))

    def _declaration_violations(self, name: str, value: ParameterValue) -> list[Violation]:
        """Return the violations of nodes' declarations by a value or by the values in a tree."""
        parameter = self.session.graph.parameters.get(name)
        if parameter is not None:
            return list(violations(parameter.descriptor or Descriptor(), name, self._space.parameter(name), value))
        if not isinstance(value, dict):
            return []
        inner = (self._declaration_violations(f"{name.rstrip('/')}/{key}", each) for key, each in value.items())
        return [violation for found in inner for violation in found]

    async def _of_parameter(self, name: str, value: ParameterValue) -> list[Violation]:
        if isinstance(value, dict):
            inner = [await self._of_parameter(f"{name.rstrip('/')}/{key}", each) for key, each in value.items()]
            return [violation for found in inner for violation in found]
        url = self._space.parameter(name)
        shape = self.limits.resource(url)
        stored = StoredValue(value)
        broken: list[Violation] = []
        if shape is not None:
            note_limits(url)
            broken += shape.violations(NamedNode(url), self._triples(url, ros.value, stored))
        return broken + await self._of_property(Kind.PARAMETER, name, stored)

    async def _of_property(self, kind: Kind, name: str, value: Value) -> list[Violation]:
        """Return the violations of limits on the property that a topic, service or parameter writes."""
        broken: list[Violation] = []
        for url, field in await self._property_names(kind, name):
            shape = self.limits.resource(url)
            if shape is not None:
                note_limits(url)
                broken += shape.violations(NamedNode(url), self._triples(url, rdf.value, value, field))
        return broken

    async def _property_names(self, kind: Kind, name: str) -> Sequence[tuple[str, str | None]]:
        """Return the URL and field of each property that a topic, service or parameter writes."""
        tree = await self.affordances.tree()
        catalogue = tree.catalogue
        ways = {
            Kind.TOPIC: catalogue.by_topic,
            Kind.SERVICE: catalogue.by_service,
            Kind.PARAMETER: catalogue.by_parameter,
        }
        found = ways[kind].get(name) if kind in ways else None
        if found is None or (
            kind is Kind.SERVICE and all(way.name != name for way in catalogue.properties[found].writers)
        ):
            return ()  # the request of a getter is not a value
        return [(url_of(shown, self._space), field) for shown, field in tree.names_of(found)]

    def _triples(self, url: str, predicate: NamedNode, value: Value, field: str | None = None) -> list[Triple]:
        return value_triples(NamedNode(url), predicate, Reading("value", value), field, self.session.lifting)


def require_no_octets(body: RdfBody, texts: Set[NamedNode]) -> None:
    """Raise LoweringError if a value of one of these properties is octets."""
    for subject, properties in body.subjects.items() if texts else ():
        for text in texts & properties.keys():
            for each in properties[text]:
                if isinstance(each, Literal) and each.datatype in BINARIES:
                    raise octets_error(text.value.rpartition("#")[2], each, subject)


def octets_error(path: str, value: Literal, subject: Term) -> LoweringError:
    """Return the error for a limited text that was written as octets."""
    focus = subject if isinstance(subject, NamedNode | BlankNode) else None
    words = "has a limit on characters: write it as text, not as octets"
    return LoweringError(
        Violation(path, words, brief_value(value.value), component(sh.datatype), focus=focus, term=value)
    )
