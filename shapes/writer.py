"""Writer of shapes graphs: named nodes of one document, blank nodes unique to it, and shapes of lists."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from hashlib import blake2b
from itertools import count

from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.adapters.model import Array
from rosld.ontology.triples import Statement, Value, integer, text, triples_about
from rosld.ontology.vocab import rdf, rdfs, sh


class ShapesWriter:
    """Writer of the shapes graph at a URL.

    The labels of blank nodes are derived from the URL, so that graphs can be concatenated in one file.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.triples: list[Triple] = []
        self._shared: set[str] = set()
        self._blanks = _blank_nodes(url)

    def add(self, node: NamedNode | BlankNode, *statements: Statement) -> None:
        """Add statements about a node; those whose value is None are omitted."""
        self.triples += triples_about(node, *statements)

    def node(self, name: str = "") -> NamedNode:
        """Return the node of a fragment (of permitted characters), or of the document itself."""
        return NamedNode(f"{self.url}#{name}" if name else self.url)

    def shared(self, name: str, write: Callable[[], Iterable[Statement]], label: str | None = None) -> NamedNode:
        """Return a node shape of the document, written on first use."""
        node = self.node(name)
        if name not in self._shared:
            self._shared.add(name)
            self.add(node, (rdf.type, sh.NodeShape), (rdfs.label, text(label or name)), *write())
        return node

    def blank(self, *statements: Statement) -> BlankNode:
        """Return a blank node with these statements."""
        node = next(self._blanks)
        self.add(node, *statements)
        return node

    def list_of(self, elements: Iterable[Value]) -> Value:
        """Return an rdf:List with blank cells."""
        rest: Value = rdf.nil
        for element in reversed(list(elements)):
            rest = self.blank((rdf.first, element), (rdf.rest, rest))
        return rest

    def either(self, shapes: Iterable[Value]) -> Statement:
        """Return the constraint that at least one of these shapes conforms."""
        return sh.or_, self.list_of(shapes)


def _blank_nodes(url: str) -> Iterator[BlankNode]:
    label = blake2b(url.encode(), digest_size=10).hexdigest()
    yield from (BlankNode(f"s{label}-{number}") for number in count())


def within(node: NamedNode, name: str) -> NamedNode:
    """Return a fragment derived from `node`: `#linear` from the document, `#twist.linear` from `#twist`."""
    return NamedNode(f"{node.value}{'.' if '#' in node.value else '#'}{name}")


def _list_shape(writer: ShapesWriter) -> Iterator[Statement]:
    """Yield the statements of a well-formed list: each cell has one rdf:first and one rdf:rest, and the list ends."""
    one = [(sh.minCount, integer(1)), (sh.maxCount, integer(1))]
    firsts, rests = (writer.blank((sh.path, path), *one) for path in (rdf.first, rdf.rest))
    end = writer.blank((sh.in_, writer.list_of([rdf.nil])))
    either = writer.either([end, writer.blank((sh.property, firsts), (sh.property, rests))])
    yield sh.nodeKind, sh.BlankNodeOrIRI
    yield sh.property, writer.blank((sh.path, _rests(writer)), (sh.hasValue, rdf.nil), either)


def list_of(writer: ShapesWriter, elements: Sequence[Statement], kind: Array) -> BlankNode:
    """Return the shape of a list with the permitted number of elements, which conform to `elements`.

    Equal literals are one value node (SHACL 2.3.1), so the cells are counted, including rdf:nil, not the elements.
    """
    path = writer.list_of([_rests(writer), rdf.first])
    shared = writer.shared("list", lambda: _list_shape(writer))
    shape = writer.blank((sh.node, shared), (sh.property, writer.blank((sh.path, path), *elements)))
    if kind.most is not None:
        least = None if kind.length is None else integer(kind.length + 1)
        counted = writer.blank((sh.path, _rests(writer)), (sh.minCount, least), (sh.maxCount, integer(kind.most + 1)))
        writer.add(shape, (sh.property, counted))
    return shape


def _rests(writer: ShapesWriter) -> NamedNode | BlankNode:
    """Return the path from a list to all of its cells, including itself and rdf:nil."""
    return writer.blank((sh.zeroOrMorePath, rdf.rest))
