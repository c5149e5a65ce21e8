"""Parser of Notation3: rdflib's parser, with the original spelling of literals.

rdflib's parser reads the syntax, but terms are created here: rdflib interprets literals (including XML), changes the
spelling of numbers, resolves `<?a>` incorrectly, and merges `?a` with `<#a>`. Nothing is downloaded.
"""

# The names are those of rdflib's parser.
# ruff: noqa: N802

from __future__ import annotations

import re
from collections.abc import MutableSequence
from typing import NoReturn, cast

from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, parse
from rdflib.plugins.parsers.notation3 import BadSyntax, RDFSink, SinkParser

from rosld.ontology.body import BodyError, check_turtle_depth, expanded_body_error, expansion_limit
from rosld.ontology.vocab import rdf, xsd
from rosld.server.patches.n3patch import Formula, Node, RefusedSyntax, Statement, Variable


def read_n3(data: bytes, base: str) -> Formula:
    """Return the document with its IRIs resolved against `base`.

    Raises BodyError if it is not UTF-8, nested too deeply, or invalid N3. The caller must limit the size.
    """
    check_turtle_depth(data)
    text = data.removeprefix(b"\xef\xbb\xbf").decode()
    parser = _Parser(cast(RDFSink, _Sink()), base, len(data))
    try:
        return cast(Formula, parser.loadBuf(text))
    except BadSyntax as error:
        raise _error(text, error._i, error._why) from error
    except RefusedSyntax as error:
        raise BodyError(str(error)) from error
    except BodyError:
        raise
    except RecursionError as error:
        raise BodyError("nested too deeply") from error
    except Exception as error:  # the parser raises various exceptions for unexpected input
        raise BodyError(f"this is not valid N3: {_words(error)}") from error


_NUMERAL = re.compile(
    r"[-+]?(?:(?P<double>(?:[0-9]+\.[0-9]*|\.?[0-9]+)[eE][-+]?[0-9]+)|(?P<decimal>[0-9]*\.[0-9]+)|(?P<integer>[0-9]+))"
)
_TAGGED = frozenset({rdf.langString.value, f"{rdf.iri}dirLangString"})
_DATATYPES = {"double": xsd.double, "decimal": xsd.decimal, "integer": xsd.integer}
_REFERENCE = re.compile(r'<[^\x00-\x20<>"{}|^`]*>')
_PLAIN = re.compile(r"<https?://[\w.:\-]+/[\w/#\-]*>", re.ASCII)
"""Absolute IRIs that resolve to themselves."""
_VARIABLE = re.compile(r"\?([^\W\d][\w\-]*)")


class _Parser(SinkParser):
    """rdflib's parser, with the original spelling of numbers and variables, and the rest of Turtle's syntax."""

    def __init__(self, store: RDFSink, base: str, size: int) -> None:
        """Create a parser. `size` is the size of the document in bytes, which limits its expanded IRIs."""
        super().__init__(store, baseURI=base)
        self.string_delimiters = ('"', "'")
        self._size = size
        self._left = expansion_limit(size)

    def directiveOrStatement(self, argstr: str, h: int) -> int:
        start = self.skipSpace(argstr, h)
        if start >= 0 and argstr[start] in "PpBb" and (end := self.sparqlDirective(argstr, start)) >= 0:
            return end
        return super().directiveOrStatement(argstr, h)

    def nodeOrLiteral(self, argstr: str, i: int, res: MutableSequence[object]) -> int:
        start = self.skipSpace(argstr, i)
        numeral = _NUMERAL.match(argstr, start) if start >= 0 else None
        if numeral is None:
            return super().nodeOrLiteral(argstr, i, res)
        assert numeral.lastgroup is not None
        res.append(Literal(numeral[0], datatype=_DATATYPES[numeral.lastgroup]))
        return numeral.end()

    def uri_ref2(self, argstr: str, i: int, res: MutableSequence[object]) -> int:
        end = self._iri(argstr, i, res)
        if end >= 0:
            self._left -= len(str(res[-1]))
            if self._left < 0:
                raise expanded_body_error(self._size)
        return end

    def _iri(self, argstr: str, i: int, res: MutableSequence[object]) -> int:
        start = self.skipSpace(argstr, i)
        if start < 0 or argstr[start] != "<":
            return super().uri_ref2(argstr, i, res)
        found = _REFERENCE.match(argstr, start)
        if found is None:
            self.BadSyntax(argstr, start, "not an IRI reference")
        assert self._baseURI is not None
        res.append(_resolve(found[0], self._baseURI))
        return found.end()

    def variable(self, argstr: str, i: int, res: MutableSequence[object]) -> int:
        start = self.skipSpace(argstr, i)
        if start < 0 or argstr[start] != "?":
            return -1
        found = _VARIABLE.match(argstr, start)
        if found is None:
            self.BadSyntax(argstr, start, "not a variable name")
        res.append(Variable(found[1]))
        return found.end()


def _resolve(reference: str, base: str) -> str:
    """Return the IRI of `<reference>`, resolved with escapes by the Turtle parser (RFC 3986 5.2)."""
    if _PLAIN.fullmatch(reference):
        return reference[1:-1]
    triple = next(parse(f"{reference} <a:b> <a:b> .", RdfFormat.TURTLE, base_iri=base))
    assert isinstance(triple.subject, NamedNode)
    return triple.subject.value


class _Sink:
    """Factory of terms and statements for the parser, which determines the method names."""

    def startDoc(self, formula: Formula) -> None:
        pass

    def endDoc(self, formula: Formula) -> None:
        pass

    def bind(self, prefix: str, uri: bytes) -> None:
        pass

    def setDefaultNamespace(self, uri: bytes) -> None:
        pass

    def newFormula(self) -> Formula:
        return Formula()

    def newSymbol(self, iri: str) -> str:
        return iri

    def newBlankNode(self, formula: Formula, uri: str | None = None, why: object = None) -> BlankNode:
        return BlankNode()

    def newLiteral(self, text: str, datatype: object = None, language: str | None = None) -> Literal:
        if datatype is None:
            return Literal(text, language=language)
        if not isinstance(datatype, str):
            raise RefusedSyntax(f"the datatype of {text[:100]!r} is not an IRI")
        if datatype in _TAGGED:
            raise RefusedSyntax(f"{text[:100]!r} has the datatype of strings with a language, but no language tag")
        return Literal(text, datatype=NamedNode(datatype))

    def newList(self, items: list[object], formula: Formula) -> Node:
        nodes = [BlankNode() for _ in items]
        rests: list[NamedNode | BlankNode] = [*nodes[1:], rdf.nil] if nodes else []
        for node, item, rest in zip(nodes, items, rests, strict=True):
            formula.statements.append(Statement(node, rdf.first, _node(item)))
            formula.statements.append(Statement(node, rdf.rest, rest))
        return nodes[0] if nodes else rdf.nil

    def newSet(self, items: list[object], formula: Formula) -> NoReturn:
        raise RefusedSyntax("sets {$ $} are not supported")

    def intern(self, term: object) -> object:
        return term

    def makeStatement(self, quadruple: tuple[Formula, object, object, object], why: object = None) -> None:
        formula, predicate, subject, object_ = quadruple
        formula.statements.append(Statement(_node(subject), _node(predicate), _node(object_)))


def _node(term: object) -> Node:
    """Return the node of a term in the parser's form: IRIs are plain text, and keywords are pairs."""
    match term:
        case NamedNode() | BlankNode() | Literal() | Variable() | Formula():
            return term
        case bool():
            return Literal("true" if term else "false", datatype=xsd.boolean)
        case str():
            return NamedNode(term)
        case (_, str(iri)):
            return NamedNode(iri)
    raise RefusedSyntax(f"{str(term)[:100]} is not a supported term")


def _error(text: str, position: int, words: str) -> BodyError:
    place = min(max(position, 0), len(text)) if position >= 0 else len(text)
    return BodyError(words, text.count("\n", 0, place) + 1, place - text.rfind("\n", 0, place))


def _words(error: Exception) -> str:
    """Return an error's message if it helps the author of the text."""
    return str(error)[:200] if isinstance(error, ValueError) else "it ends too early or has unexpected content"
