"""Turtle for people: a base, the prefixes in use, one paragraph per subject (RDF 1.1 Turtle)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.outline import DEPTH, Outline, Statements, Subject, Term, outline
from rosld.ontology.vocab import NAMESPACES, PREFIXES, rdf, xsd

_LOCAL = re.compile(r"[A-Za-z_](?:[\w-]*\w)?", re.ASCII)
_BARE = {xsd.integer.value: re.compile(r"0|-?[1-9][0-9]*"), xsd.boolean.value: re.compile(r"true|false")}
"""Literals written without quotes, only in forms that every reader preserves (some turn `01` into `1`)."""

_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r", "\t": "\\t"}
_TO_ESCAPE = re.compile('[\\\\"\\x00-\\x1f\\x7f-\\x9f\u2028\u2029\ufffe\uffff]')
_LONG_TO_ESCAPE = re.compile('[\\\\"\\x00-\\x09\\x0b-\\x1f\\x7f-\\x9f\u2028\u2029\ufffe\uffff]')


def quote_turtle(text: str) -> str:
    """Return a quoted string; one of several lines in long quotes, so that definitions read as in their source."""
    if not _TO_ESCAPE.search(text):
        return f'"{text}"'
    if "\n" in text.strip("\n"):
        return f'"""{_LONG_TO_ESCAPE.sub(_escape, text)}"""'
    return f'"{_TO_ESCAPE.sub(_escape, text)}"'


def _escape(match: re.Match[str]) -> str:
    return _ESCAPES.get(match[0]) or f"\\u{ord(match[0]):04X}"


@lru_cache(maxsize=4096)
def prefixed_name(iri: str) -> tuple[str, str | None]:
    """Return the IRI as a prefixed name and its prefix, or in angle brackets and None."""
    cut = max(iri.rfind("#"), iri.rfind("/")) + 1
    prefix = NAMESPACES.get(iri[:cut])
    if prefix is None or not _LOCAL.fullmatch(iri, cut):
        return f"<{iri}>", None
    return f"{prefix}:{iri[cut:]}", prefix


class _Writer:
    """Writer of one document; `prefixes` are those used so far."""

    def __init__(self, shape: Outline, base: str) -> None:
        self.shape = shape
        self.fragment = base + "#"
        self.prefixes: set[str] = set()
        self.waiting: list[Subject] = [subject for subject in shape.subjects if self._stands_alone(subject)]
        self.written: set[Subject] = set()

    def _stands_alone(self, subject: Subject) -> bool:
        return isinstance(subject, NamedNode) or (subject not in self.shape.nested and subject not in self.shape.cells)

    def paragraphs(self) -> Iterator[str]:
        """Yield all subjects; blank nodes that only refer to each other are last."""
        yield from self._waiting()
        for subject in self.shape.subjects:
            # List cells without a link belong to a blank node written below, or to a cycle of them.
            if subject not in self.written:
                self.waiting.append(subject)
                yield from self._waiting()

    def _waiting(self) -> Iterator[str]:
        position = 0
        while position < len(self.waiting):
            subject = self.waiting[position]
            position += 1
            if subject in self.written:
                continue
            self.written.add(subject)
            text = self.iri(subject.value) if isinstance(subject, NamedNode) else str(subject)
            yield f"{text} {self.statements(self.shape.subjects[subject], 0)} .\n"
        self.waiting.clear()

    def statements(self, statements: Statements, depth: int) -> str:
        """Return predicates with objects, one per line; `a` first."""
        indent = "\n" + "    " * (depth + 1)
        kinds = statements.get(rdf.type)
        lines = [f"a {self.objects(kinds, depth)}"] if kinds else []
        lines += [
            f"{self.iri(predicate.value)} {self.objects(objects, depth)}"
            for predicate, objects in statements.items()
            if predicate != rdf.type
        ]
        return f" ;{indent}".join(lines)

    def objects(self, objects: Iterable[Term], depth: int) -> str:
        """Return the objects of one predicate."""
        return ", ".join([self.term(term, depth) for term in objects])

    def term(self, term: Term, depth: int) -> str:
        """Return one object."""
        if isinstance(term, NamedNode):
            return "()" if term == rdf.nil else self.iri(term.value)
        if isinstance(term, Literal):
            return self.literal(term)
        if isinstance(term, BlankNode):
            return self.blank(term, depth)
        return f"<<( {term} )>>"

    def blank(self, blank: BlankNode, depth: int) -> str:
        """Return a blank node: as a list, nested in brackets, or by its label."""
        if blank in self.written or depth >= DEPTH or self._stands_alone(blank) or blank not in self.shape.subjects:
            if blank in self.shape.subjects and blank not in self.written:
                self.waiting.append(blank)
            return str(blank)
        elements = self.shape.lists.get(blank)
        if elements is not None:
            self.written.update(self.shape.cells_of(blank))
            return f"( {' '.join([self.term(element, depth + 1) for element in elements])} )"
        if blank in self.shape.cells:  # the rest of a list whose head had to be written as a cell
            self.waiting.append(blank)
            return str(blank)
        self.written.add(blank)
        inner = "\n" + "    " * (depth + 2)
        return f"[{inner}{self.statements(self.shape.subjects[blank], depth + 1)} ]"

    def iri(self, iri: str) -> str:
        """Return an IRI: a prefixed name, a fragment of this document, or in full."""
        if iri.startswith(self.fragment):
            return f"<{iri[len(self.fragment) - 1 :]}>"
        text, prefix = prefixed_name(iri)
        if prefix is not None:
            self.prefixes.add(prefix)
        return text

    def literal(self, literal: Literal) -> str:
        """Return a literal, without quotes if Turtle allows that."""
        if literal.language is not None:
            return str(literal)
        datatype = literal.datatype.value
        if datatype == xsd.string.value:
            return quote_turtle(literal.value)
        bare = _BARE.get(datatype)
        if bare is not None and bare.fullmatch(literal.value):
            return literal.value
        return f"{quote_turtle(literal.value)}^^{self.iri(datatype)}"


def turtle(document: Document) -> str:
    """Return the document in Turtle; messages follow the description."""
    prefixes, body = _sections(document)
    return f"{_header(document.url, prefixes)}\n{body}"


def trig(document: Document) -> str:
    """Return the document in TriG: its triples are in the graph named by its URL."""
    prefixes, body = _sections(document, inner="    ")
    return f"{_header(document.url, prefixes)}\n<{document.url}> {{\n{body}}}\n"


def _header(base: str, prefixes: Mapping[str, str]) -> str:
    return f"@base <{base}> .\n" + "".join([_declaration(*prefix) for prefix in prefixes.items()])


def _declaration(prefix: str, iri: str) -> str:
    return f"@prefix {prefix}: <{iri}> .\n"


def _sections(document: Document, inner: str = "") -> tuple[dict[str, str], str]:
    """Return the prefixes for the head, and the body."""
    writer = _Writer(outline(document.triples), document.url)
    sections = list(writer.paragraphs())
    prefixes = {prefix: PREFIXES[prefix] for prefix in sorted(writer.prefixes)}
    return _with_messages(document, prefixes, sections, declare=not inner)


def _with_messages(
    document: Document, prefixes: dict[str, str], sections: list[str], *, declare: bool
) -> tuple[dict[str, str], str]:
    """Return the sections and prefixes with those of the messages.

    Two messages may need one prefix for two namespaces (`request` and `response` of types with the same name); Turtle
    allows redeclaring a prefix between statements. TriG does not within a graph, so such a message has full IRIs.
    """
    current = dict(prefixes)
    for message in document.messages:
        wanted = message.prefixes
        clash = {prefix: iri for prefix, iri in wanted.items() if current.get(prefix, iri) != iri}
        for prefix, iri in wanted.items():
            if prefix not in current:
                prefixes[prefix] = current[prefix] = iri
        if clash and not declare:
            sections.append(message.text(document, "ntriples"))
            continue
        current |= clash
        sections.append("".join([_declaration(*prefix) for prefix in clash.items()]) + message.text(document, "turtle"))
    return prefixes, "\n".join(section if section.endswith("\n") else section + "\n" for section in sections)
