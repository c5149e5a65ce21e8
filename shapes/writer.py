"""Writer of shapes graphs: named nodes of one document, and blank nodes unique to it."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b
from itertools import count

from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.ontology.triples import Statement, Value, triples_about
from rosld.ontology.vocab import rdf, sh


class ShapesWriter:
    """Collects the triples of the shapes graph at a URL.

    The labels of blank nodes are made from the URL, so that graphs can be written side by side into one file.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.triples: list[Triple] = []
        label = blake2b(url.encode(), digest_size=10).hexdigest()
        self._blanks = (BlankNode(f"s{label}-{number}") for number in count())

    def add(self, node: NamedNode | BlankNode, *statements: Statement) -> None:
        """Say something about a node; a statement whose value is None is none."""
        self.triples += triples_about(node, *statements)

    def node(self, name: str = "") -> NamedNode:
        """The node of that fragment, which is made of characters that a fragment may hold; without, the document."""
        return NamedNode(f"{self.url}#{name}" if name else self.url)

    def blank(self, *statements: Statement) -> BlankNode:
        """A blank node about which this is said."""
        node = next(self._blanks)
        self.add(node, *statements)
        return node

    def list_of(self, elements: Iterable[Value]) -> Value:
        """An rdf:List, its cells blank."""
        rest: Value = rdf.nil
        for element in reversed(list(elements)):
            rest = self.blank((rdf.first, element), (rdf.rest, rest))
        return rest

    def either(self, shapes: Iterable[Value]) -> Statement:
        """The constraint that one of these shapes holds at least."""
        return sh.or_, self.list_of(shapes)


def within(node: NamedNode, name: str) -> NamedNode:
    """A fragment of the document of `node`, named after it: of `#twist` `#twist.linear`, of a document `#linear`."""
    return NamedNode(f"{node.value}{'.' if '#' in node.value else '#'}{name}")
