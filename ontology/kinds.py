"""Kinds of values in descriptions: the conversion of a value to a term, and the SHACL constraints of the term."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import Generic, TypeVar

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import TypeRef
from rosld.ontology.triples import Value, boolean, date_time_literal, double, integer, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import xsd

V = TypeVar("V")


class Kind(Struct, Generic[V], frozen=True):
    """Kind of value: the conversion to a term, and the constraints of the term in Turtle.

    `url` returns the URL that is the term. Without functions a value is a suffix of its subject's URL.
    """

    term: Callable[[V], Value | None] | None
    shacl: str
    url: Callable[[Space, V], str] | None = None

    def where(self, shacl: str) -> Kind[V]:
        """Return the kind with more constraints."""
        return replace(self, shacl=f"{self.shacl} ; {shacl}")


def link(url: Callable[[Space, V], str], pattern: str = "") -> Kind[V]:
    """Return the kind of links to a resource of the server, given its name; its URL matches `pattern`."""
    constraints = f'sh:nodeKind sh:IRI ; sh:pattern "{pattern}"' if pattern else "sh:nodeKind sh:IRI"
    return Kind(None, constraints, url)


def node(shape: str) -> Kind[Value]:
    """Return the kind of nodes that another shape describes."""
    return Kind(_same, f"sh:node <#{shape}>")


def shape_of(part: str = "") -> Kind[TypeRef]:
    """Return the kind of links to the shape of a type, or to that of a part of it (`_Request`)."""
    return link(lambda space, ref: space.shape(ref.name + part), "/shapes/")


def _same(term: Value) -> Value:
    return term


TEXT: Kind[str] = Kind(text, "sh:datatype xsd:string")
NAME = TEXT.where('sh:pattern "^/"')
COUNT: Kind[int] = Kind(integer, "sh:datatype xsd:integer ; sh:minInclusive 0")
DOUBLE: Kind[float] = Kind(double, "sh:datatype xsd:double")
AMOUNT, POSITIVE = DOUBLE.where("sh:minInclusive 0"), DOUBLE.where("sh:minExclusive 0")
SECONDS: Kind[int] = Kind(lambda ns: double(ns / 1e9), AMOUNT.shacl)
"""A duration, given in nanoseconds."""
DECIMAL: Kind[float] = Kind(
    lambda value: Literal(format(Decimal(str(value)), "f"), datatype=xsd.decimal), "sh:datatype xsd:decimal"
)
BOOLEAN: Kind[bool] = Kind(boolean, "sh:datatype xsd:boolean")
FLAG: Kind[bool] = Kind(boolean, "sh:in ( true )")
"""A boolean written only if it is true: the value is True or None."""
DATE_TIME: Kind[int] = Kind(date_time_literal, "sh:datatype xsd:dateTime")
"""A time, given in nanoseconds after the epoch."""
URI: Kind[str] = Kind(lambda value: Literal(value, datatype=xsd.anyURI), "sh:datatype xsd:anyURI")
IRI: Kind[str] = Kind(NamedNode, "sh:nodeKind sh:IRI")
TERM: Kind[Value] = Kind(_same, "sh:nodeKind sh:IRI")
LITERAL: Kind[Value] = Kind(_same, "sh:nodeKind sh:Literal")
STATE = node("State")
FRAGMENT: Kind[str] = Kind(None, "sh:nodeKind sh:IRI")
"""A suffix of the subject's URL, such as `#request`."""
MESSAGE = replace(FRAGMENT, shacl="sh:node <#Message>")
NODE, TOPIC, SERVICE = link(Space.node, "/nodes/"), link(Space.topic, "/topics/"), link(Space.service, "/services/")
ACTION, GOAL, HOLD = link(Space.action, "/actions/"), link(Space.goal, "/goals/"), link(Space.hold, "/holds/")
ACTIVITY, BAG = link(Space.activity, "/activity/"), link(Space.bag, "/bags/")
PARAMETER: Kind[str] = link(lambda space, name: space.parameter(name), "/parameters/")
TYPE, SHAPE = link(Space.type, "/types/"), shape_of()
CLASS: Kind[TypeRef] = link(lambda space, ref: space.class_of(ref.name))
ACTION_AFFORDANCE = IRI.where("sh:class td:ActionAffordance")
EVENT_AFFORDANCE = IRI.where("sh:class td:EventAffordance")
ENDPOINT = IRI.where("sh:class ros:Endpoint")
