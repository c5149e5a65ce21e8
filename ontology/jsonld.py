"""Compact JSON-LD 1.1 with an inline context for the one document: reading it needs no further resource.

Every number is a string with its datatype in the context, because JSON numbers lose digits. A term is in the context
only if no IRI of the document could be mistaken for a compact IRI that begins with it (JSON-LD 1.1 5.2).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

import orjson
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.outline import DEPTH, Outline, Statements, Subject, Term, outline
from rosld.ontology.syntax import CannotCarry
from rosld.ontology.vocab import NAMESPACES, rdf, ros, xsd

Json: TypeAlias = "str | bool | list[Json] | dict[str, Json] | orjson.Fragment | None"

_LOCAL = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_ID = "@id"


def jsonld(document: Document) -> bytes:
    """Return the document in compact JSON-LD: the node of its URL with linked nodes nested, and the other nodes."""
    return _Writer(document).text()


class _Writer:
    """Writer of one document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.shape = outline(document.triples)
        self.fragment = document.url + "#"
        self.forbidden = _schemes(document.triples)
        self.context: dict[str, object] = {"@base": document.url}
        self.keys: dict[NamedNode, tuple[str, str | None]] = {}
        self.messages = {document.url + message.node: message for message in document.messages}
        self.embedded = self._adopt_contexts()
        self.written: set[Subject] = set()

    def text(self) -> bytes:
        """Return the complete text."""
        for predicate, objects in _by_predicate(self.shape).items():
            self.keys[predicate] = self._key(predicate, objects)
        nodes = list(self._nodes())
        body: dict[str, object] = {"@context": self.context}
        if len(nodes) == 1 and isinstance(nodes[0], dict):
            body |= nodes[0]
        else:
            body["@graph"] = nodes
        if observations := self._observations():
            body["@included"] = observations
        return orjson.dumps(body)

    def _adopt_contexts(self) -> set[str]:
        """Add the contexts of messages; return the nodes of messages with conflicting ones."""
        embedded: set[str] = set()
        for iri, message in self.messages.items():
            wanted = message.context
            if any(self.context.get(term, value) != value for term, value in wanted.items()):
                embedded.add(iri)
            else:
                self.context |= wanted
        return embedded

    # The context

    def _prefix(self, iri: str) -> str | None:
        """Return the compact form of `iri` if its namespace has a usable prefix, which is added to the context."""
        cut = max(iri.rfind("#"), iri.rfind("/")) + 1
        prefix = NAMESPACES.get(iri[:cut])
        if prefix is None or not _LOCAL.fullmatch(iri, cut) or not self._define(prefix, iri[:cut]):
            return None
        return f"{prefix}:{iri[cut:]}"

    def _define(self, term: str, value: object) -> bool:
        """Add a term to the context; return False if it is taken or ambiguous."""
        if term in self.forbidden:
            return False
        return self.context.setdefault(term, value) == value

    def _key(self, predicate: NamedNode, objects: Iterable[Term]) -> tuple[str, str | None]:
        """Return the key for a predicate and the kind to which the context coerces its values (None: no coercion)."""
        iri = predicate.value
        kinds = {self._kind(term) for term in objects}
        kind = kinds.pop() if len(kinds) == 1 else None
        if predicate == rdf.type:
            return ("@type", kind) if kind == _ID else (iri, None)
        local = iri[len(ros.iri) :] if iri.startswith(ros.iri) else None
        key = local if local and _LOCAL.fullmatch(local) else self._prefix(iri)
        if key is None:
            return iri, None
        definition: dict[str, str] = {_ID: iri}
        if kind is not None and kind != xsd.string.value:
            definition["@type"] = kind if kind == _ID else self._prefix(kind) or kind
        if self._define(key, definition):
            return key, kind
        return iri, None

    def _kind(self, term: Term) -> str | None:
        """Return `@id` for nodes, the datatype for literals, None for terms that are always written in full."""
        if isinstance(term, NamedNode):
            return None if term == rdf.nil else _ID
        if isinstance(term, BlankNode):
            return None if term in self.shape.lists else _ID
        if isinstance(term, Literal) and term.language is None:
            return term.datatype.value
        return None

    # The nodes

    def _nodes(self) -> Iterator[Json]:
        """Yield the nodes that are not nested in another, the document itself first, cycles of blank nodes last."""
        own = NamedNode(self.document.url)
        subjects = [own, *self.shape.subjects] if own in self.shape.subjects else list(self.shape.subjects)
        inner = self.shape.nested | self.shape.cells
        for subject in (*(subject for subject in subjects if subject not in inner), *subjects):
            if subject not in self.written:
                yield self._node(subject, 0)
        for iri in list(self.messages):
            yield self._message(iri)

    def _node(self, subject: Subject, depth: int) -> Json:
        self.written.add(subject)
        node: dict[str, Json] = {}
        if isinstance(subject, NamedNode):
            node[_ID] = self._iri(subject)
        elif subject not in self.shape.nested or depth == 0:
            node[_ID] = str(subject)
        return node | self._statements(self.shape.subjects[subject], depth)

    def _statements(self, statements: Statements, depth: int) -> dict[str, Json]:
        found: dict[str, Json] = {}
        for predicate, objects in statements.items():
            key, kind = self.keys[predicate]
            values = [self._value(term, key, kind, depth) for term in objects]
            found[key] = values[0] if len(values) == 1 else values
        return found

    def _value(self, term: Term, key: str, kind: str | None, depth: int) -> Json:
        """Return one object; its key's coercion determines the form."""
        if isinstance(term, Literal):
            return _literal(term, self._prefix(term.datatype.value)) if kind is None else term.value
        if isinstance(term, Triple):
            raise CannotCarry("JSON-LD 1.1 cannot carry a triple term; ask for Turtle or N-Triples")
        if isinstance(term, BlankNode):
            return str(term) if key == "@type" else self._blank(term, kind, depth)
        if key == "@type":
            return self._prefix(term.value) or self._iri(term)
        if term == rdf.nil:
            return {"@list": []}
        if term.value in self.messages:
            return self._message(term.value)
        if self._may_nest(term) and depth < DEPTH:
            return self._node(term, depth + 1)
        return self._iri(term) if kind == _ID else {_ID: self._iri(term)}

    def _may_nest(self, term: NamedNode) -> bool:
        """Whether a node is nested at its first link."""
        return term in self.shape.subjects and term not in self.written

    def _blank(self, blank: BlankNode, kind: str | None, depth: int) -> Json:
        elements = self.shape.lists.get(blank)
        if elements is not None and depth < DEPTH and blank not in self.written:
            self.written.update(self.shape.cells_of(blank))
            return {"@list": [self._value(element, "", None, depth + 1) for element in elements]}
        if blank in self.shape.nested and blank not in self.written and depth < DEPTH:
            return self._node(blank, depth + 1)
        return str(blank) if kind == _ID else {_ID: str(blank)}

    def _message(self, iri: str) -> Json:
        """Return the node object of a message, with its own context if it conflicts with that of the document."""
        message: LiftedMessage = self.messages.pop(iri)
        text = message.text(self.document, "jsonld")
        context = self._own_context(message)
        return orjson.Fragment(f"{{{context}{text.lstrip()[1:]}" if context else text)

    def _own_context(self, message: LiftedMessage) -> str:
        """Return the member for the context of a message if that conflicts with the context of the document."""
        if self.document.url + message.node not in self.embedded:
            return ""
        return f'"@context":{orjson.dumps(dict(message.context)).decode()},'

    def _observations(self) -> list[Json]:
        """Return the node objects of the observations of all messages."""
        found: list[Json] = []
        for message in self.document.messages:
            if nodes := message.observations(self.document, "jsonld")[:-1]:
                context = self._own_context(message)
                found.append(orjson.Fragment(f'{{{context}"@included":[{nodes}]}}' if context else nodes))
        return found

    def _iri(self, term: NamedNode) -> str:
        iri = term.value
        return iri[len(self.fragment) - 1 :] if iri.startswith(self.fragment) else iri


def _literal(literal: Literal, compact: str | None) -> Json:
    """Return a literal without coercion: a string, or a value object."""
    if literal.direction is not None:
        raise CannotCarry(f"JSON-LD cannot carry the base direction of {literal.value!r}; ask for Turtle")
    if literal.language is not None:
        return {"@value": literal.value, "@language": literal.language}
    datatype = literal.datatype.value
    return literal.value if datatype == xsd.string.value else {"@value": literal.value, "@type": compact or datatype}


def _by_predicate(shape: Outline) -> Mapping[NamedNode, list[Term]]:
    objects: dict[NamedNode, list[Term]] = {}
    for statements in shape.subjects.values():
        for predicate, terms in statements.items():
            objects.setdefault(predicate, []).extend(terms)
    return objects


def _schemes(triples: Iterable[Triple]) -> frozenset[str]:
    """Return the prefixes of all IRIs that a JSON-LD processor could take for compact IRIs.

    An IRI whose colon is followed by two slashes is never one (JSON-LD 1.1 API 5.2.2).
    """
    found: set[str] = set()
    for triple in triples:
        for term in (triple.subject, triple.predicate, triple.object):
            iri = term.datatype.value if isinstance(term, Literal) else getattr(term, "value", "")
            scheme, colon, rest = iri.partition(":")
            if colon and not rest.startswith("//"):
                found.add(scheme)
    return frozenset(found)
