"""RDF/XML (RDF 1.1 XML Syntax): flat, one rdf:Description per subject. It cannot represent all graphs."""

from __future__ import annotations

import re
from collections.abc import Iterable

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.outline import Subject, Term, outline
from rosld.ontology.syntax import CannotCarry
from rosld.ontology.vocab import NAMESPACES, rdf, xsd

# The local part of an element's name is ASCII if possible, as XML's fourth and fifth editions differ on other letters;
# otherwise it may have all characters of the fifth (NameStartChar, NameChar; Namespaces in XML 1.0: no colon).
_START = (
    "A-Z_a-z\xc0-\xd6\xd8-\xf6\xf8-\u02ff\u0370-\u037d\u037f-\u1fff\u200c\u200d\u2070-\u218f\u2c00-\u2fef"
    "\u3001-\ud7ff\uf900-\ufdcf\ufdf0-\ufffd\U00010000-\U000effff"
)
_SPLIT_ASCII = re.compile(r"(.*?)([A-Za-z_][A-Za-z0-9_.-]*)", re.DOTALL)
_SPLIT = re.compile(f"(.*?)([{_START}][{_START}.0-9\xb7\u0300-\u036f\u203f\u2040-]*)", re.DOTALL)
_NO_CHARACTER = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# Not from `xml.sax.saxutils`, which imports all of urllib and ssl: a third of the start of a query process.
_IN_TEXT = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"})
_IN_QUOTES = _IN_TEXT | str.maketrans({'"': "&quot;", "\n": "&#10;", "\t": "&#9;"})
_RESERVED_NAMESPACES = frozenset({"http://www.w3.org/XML/1998/namespace", "http://www.w3.org/2000/xmlns/"})
_NO_PROPERTIES = frozenset(
    rdf.iri + name
    for name in (
        "RDF", "ID", "about", "parseType", "resource", "nodeID", "datatype", "Description", "li",
        "aboutEach", "aboutEachPrefix", "bagID",
    )
)  # fmt: skip
"""IRIs that no property element may have (RDF 1.1 XML Syntax 6.1.4), and rdf:li, which readers would number."""


def rdfxml(triples: Iterable[Triple], base: str) -> str:
    """Return the triples in RDF/XML. Raises CannotCarry for terms that XML cannot represent."""
    writer = _Writer()
    body = [writer.description(subject, statements) for subject, statements in outline(triples).subjects.items()]
    names = "".join(f"\n    xmlns:{prefix}={_quote(iri)}" for iri, prefix in writer.namespaces.items())
    head = f'<?xml version="1.0" encoding="UTF-8"?>\n<rdf:RDF xml:base={_quote(base)}{names}>\n'
    return f"{head}{''.join(body)}</rdf:RDF>\n"


class _Writer:
    """Writer of descriptions; `namespaces` are those used so far, with their prefixes."""

    def __init__(self) -> None:
        self.namespaces: dict[str, str] = {rdf.iri: "rdf"}
        self.labels: dict[BlankNode, str] = {}

    def description(self, subject: Subject, statements: dict[NamedNode, list[Term]]) -> str:
        """Return all statements about one subject."""
        lines = [
            f"    {self._element(name, term)}\n"
            for name, objects in [(self._name(predicate.value), objects) for predicate, objects in statements.items()]
            for term in objects
        ]
        return f"  <rdf:Description {self._node(subject, 'rdf:about')}>\n{''.join(lines)}  </rdf:Description>\n"

    def _element(self, name: str, term: Term) -> str:
        if isinstance(term, Triple):
            raise CannotCarry("RDF/XML 1.1 cannot carry a triple term; ask for Turtle or N-Triples")
        if isinstance(term, Literal):
            return f"<{name}{_attributes(term)}>{_text(term.value)}</{name}>"
        return f"<{name} {self._node(term, 'rdf:resource')}/>"

    def _node(self, node: Subject, attribute: str) -> str:
        """Return the attribute that identifies a node."""
        if isinstance(node, NamedNode):
            return f"{attribute}={_quote(node.value)}"
        return f'rdf:nodeID="{self.labels.setdefault(node, f"b{len(self.labels)}")}"'

    def _name(self, iri: str) -> str:
        """Return the element name of a predicate. Raises CannotCarry if the IRI does not end in an XML name."""
        split = _SPLIT_ASCII.fullmatch(iri) or _SPLIT.fullmatch(iri)
        if split is None or split[1] in _RESERVED_NAMESPACES or iri in _NO_PROPERTIES:
            raise CannotCarry(f"RDF/XML cannot write the property <{iri}> as the name of an element; ask for Turtle")
        namespace, local = split[1], split[2]
        if namespace not in self.namespaces:
            self.namespaces[namespace] = NAMESPACES.get(namespace) or f"ns{len(self.namespaces)}"
        return f"{self.namespaces[namespace]}:{local}"


def _attributes(literal: Literal) -> str:
    """Return the language or the datatype of a literal, as attributes."""
    if literal.direction is not None:
        raise CannotCarry(f"RDF/XML 1.1 cannot carry the base direction of {literal.value!r}; ask for Turtle")
    if literal.language is not None:
        return f' xml:lang="{literal.language}"'
    datatype = literal.datatype.value
    return "" if datatype == xsd.string.value else f" rdf:datatype={_quote(datatype)}"


def _text(value: str) -> str:
    """Return character data. A carriage return is a reference, as readers convert the character (XML 2.11)."""
    if found := _NO_CHARACTER.search(value):
        raise CannotCarry(f"XML cannot contain the character U+{ord(found[0]):04X} of {value[:60]!r}; ask for Turtle")
    return value.translate(_IN_TEXT)


def _quote(value: str) -> str:
    """Return the value of an attribute, in quotes."""
    return f'"{value.translate(_IN_QUOTES)}"'
