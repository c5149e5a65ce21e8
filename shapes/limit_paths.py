"""Paths of limits: what the predicates that a shape names lead to, in a message or at a resource."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from pyoxigraph import NamedNode

from rosld.adapters.model import Array, MessageSchema, Nested, ParameterType, Primitive
from rosld.ontology.literals import DATATYPES
from rosld.ontology.urls import Space
from rosld.ontology.vocab import xsd
from rosld.shapes.accepted_values import PARAMETERS

Kind: TypeAlias = Primitive | Nested | Array | ParameterType


@dataclass(frozen=True, slots=True)
class ValuePlace:
    """A place that a path leads to: a value of a kind, in a message of a schema where it is in one."""

    kind: Kind
    schema: MessageSchema | None = None

    @classmethod
    def message(cls, schema: MessageSchema, name: str | None = None) -> ValuePlace:
        """A message of a schema, or one of the types nested in it."""
        return cls(Nested(name or schema.ref.name), schema)

    @property
    def primitive(self) -> Primitive | None:
        """What a scalar is; None for everything else."""
        return PARAMETERS.get(self.kind) if isinstance(self.kind, ParameterType) else _primitive(self.kind)

    @property
    def datatype(self) -> NamedNode | None:
        """The datatype that the server itself says a scalar with."""
        if self.kind is ParameterType.INTEGER:
            return xsd.integer
        return None if self.primitive is None else NamedNode(xsd.iri + DATATYPES[self.primitive.name])

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """The field that a predicate leads to; None where it is none of the type."""
        name = self.kind.name if isinstance(self.kind, Nested) else ""
        return self._field(lambda field: space.property_of(name, field) == predicate.value)

    def field(self, path: str) -> ValuePlace | None:
        """The field at a dotted path."""
        name, _, rest = path.partition(".")
        found = self._field(lambda field: field == name)
        return found.field(rest) if found is not None and rest else found

    def _field(self, is_it: Callable[[str], bool]) -> ValuePlace | None:
        if self.schema is None or not isinstance(self.kind, Nested):
            return None
        fields = (each for each in self.schema.types[self.kind.name].fields if is_it(each.name))
        return next((ValuePlace(each.type, self.schema) for each in fields), None)


@dataclass(frozen=True, slots=True)
class ResourcePlace:
    """A resource that a limit is about: the predicate of its value (`rdf:value`, `ros:latest`), and what that is."""

    predicate: NamedNode
    value: ValuePlace | None

    def follow(self, predicate: NamedNode, space: Space) -> ValuePlace | None:
        """The value, by its predicate."""
        return self.value if predicate == self.predicate else None


Place: TypeAlias = ValuePlace | ResourcePlace


def _primitive(kind: Kind) -> Primitive | None:
    return kind if isinstance(kind, Primitive) else None
