"""Shapes of RDF lists (RDF Schema 5.2): that they are lists, what their elements are, how many there are."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import BlankNode, NamedNode

from rosld.ontology.triples import Statement, integer
from rosld.ontology.vocab import rdf, sh
from rosld.shapes.writer import ShapesWriter

LIST = "list"
"""The name of the node shape of all lists, whatever they hold."""


def write_list_shape(writer: ShapesWriter) -> None:
    """Write the shape `#list` of a well-formed list: each cell has one rdf:first and one rdf:rest, and it ends."""
    cells, one = writer.blank(), [(sh.minCount, integer(1)), (sh.maxCount, integer(1))]
    firsts, rests = (writer.blank((sh.path, path), *one) for path in (rdf.first, rdf.rest))
    end = writer.blank((sh.in_, writer.list_of([rdf.nil])))
    cell = writer.blank((sh.property, firsts), (sh.property, rests))
    writer.add(writer.node(LIST), (rdf.type, sh.NodeShape), (sh.nodeKind, sh.BlankNodeOrIRI), (sh.property, cells))
    writer.add(cells, (sh.path, _rests(writer)), (sh.hasValue, rdf.nil), writer.either([end, cell]))


def list_of(
    writer: ShapesWriter, elements: Sequence[Statement], length: int | None = None, bound: int | None = None
) -> BlankNode:
    """The shape of a list of which each element fulfils `elements`: of exactly `length`, or at most `bound` elements.

    Equal literals are one value node (SHACL 2.3.1), so it is not the elements that are counted: it is the cells, among
    them rdf:nil.
    """
    path = writer.list_of([_rests(writer), rdf.first])
    shape = writer.blank(
        (sh.node, writer.node(LIST)), (sh.property, writer.blank((sh.path, path), *elements))
    )  # fmt: skip
    most = length if length is not None else bound
    if most is not None:
        least = None if length is None else integer(length + 1)
        counted = writer.blank((sh.path, _rests(writer)), (sh.minCount, least), (sh.maxCount, integer(most + 1)))
        writer.add(shape, (sh.property, counted))
    return shape


def _rests(writer: ShapesWriter) -> NamedNode | BlankNode:
    """The path from a list to all of its cells, itself and rdf:nil included."""
    return writer.blank((sh.zeroOrMorePath, rdf.rest))
