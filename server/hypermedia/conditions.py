"""Conditions of mappings, evaluated on the readings of a resource. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pyoxigraph import NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import rdf
from rosld.server.hypermedia.mapping import Condition
from rosld.server.hypermedia.resource_tree import ResourceTree, segments_of
from rosld.server.hypermedia.value import MessageValue, Reading, lift_value, value_literal


class ConditionResults:
    """Results of the conditions of one resource tree for one set of readings, each evaluated once."""

    def __init__(
        self, tree: ResourceTree, readings: Mapping[str, Reading], space: Space, lifting: LiftSettings
    ) -> None:
        self._tree = tree
        self._readings = readings
        self._space = space
        self._lifting = lifting
        self._broken: dict[str, tuple[Violation, ...]] = {}

    def hold(self, conditions: Iterable[Condition]) -> bool:
        """Whether all of these conditions hold."""
        return not any(self.violations_of(condition) for condition in conditions)

    def violations(self, conditions: Iterable[Condition]) -> tuple[Violation, ...]:
        """Return the violations of these conditions."""
        return tuple(violation for condition in conditions for violation in self.violations_of(condition))

    def about(self, conditions: Iterable[Condition]) -> list[str]:
        """Return the URLs of the subjects of conditions, and of the sources of those that could not be read."""
        about = [condition.about for condition in conditions]
        readings = [reading for each in about for reading, _ in self._parts(each).values() if reading is not None]
        return [*(url_of(each, self._space) for each in about), *(url for each in readings for url in each.about)]

    def violations_of(self, condition: Condition) -> tuple[Violation, ...]:
        """Return the violations of a condition; empty if it holds. An unreadable state never conforms."""
        known = self._broken.get(condition.iri)
        if known is None:
            known = self._broken[condition.iri] = self._permissions(condition)
        return known

    def _permissions(self, condition: Condition) -> tuple[Violation, ...]:
        about = condition.about
        parts = self._parts(about)
        wanted = parts.keys() if condition.shape.paths is None else condition.shape.paths
        focus = NamedNode(url_of(about, self._space))
        triples: list[Triple] = []
        for predicate in wanted:
            if predicate not in parts:
                return (Violation(about, f"there is no {predicate.value} at {about} now"),)
        for predicate, (reading, field) in parts.items():
            if reading is None or reading.value is None:
                if predicate in wanted:
                    return (Violation(about, _unreadable(about, reading)),)
                continue
            triples += value_triples(focus, predicate, reading, field, self._lifting)
        return condition.shape.violations(focus, triples)

    def _parts(self, about: str) -> dict[NamedNode, tuple[Reading | None, str | None]]:
        """Return the state that a condition is about: by predicate, the reading and the selected field."""
        if not about.endswith("/"):
            return {rdf.value: (self._readings.get(about), None)}
        mapped = self._tree.mapping_set.resources.get(about)
        if mapped is None:
            return {}
        return {one.predicate: (self._readings.get(one.member), one.field) for one in mapped.properties}


def url_of(name: str, space: Space) -> str:
    """Return the URL of a property or action (a name) or of a complex resource (a path)."""
    if name.endswith("/"):
        return space.container("resources", segments_of(name))
    return space.url("resources", tuple(name[1:].split("/")))


def value_triples(
    subject: NamedNode, predicate: NamedNode, reading: Reading, field: str | None, lifting: LiftSettings
) -> list[Triple]:
    """Return the triples that state a value as `subject` `predicate`, including the nodes of a message."""
    value = reading.value
    if value is None:
        return []
    try:
        scalar = value_literal(value, field)
    except ValueError:
        return []
    if scalar is not None:
        return [Triple(subject, predicate, scalar)]
    if not isinstance(value, MessageValue):
        return []
    node = f"#{reading.name.rpartition('/')[2]}"
    document = Document(subject.value, (), (lift_value(value, node, lifting),))
    return [Triple(subject, predicate, NamedNode(subject.value + node)), *document.all_triples()]


def _unreadable(about: str, reading: Reading | None) -> str:
    if reading is None:
        return f"the state of {about} cannot be read: it does not exist"
    why = reading.failure or "it has no value yet"
    return f"the state of {about} cannot be read: {reading.name}: {why}"
