"""Parsing of updates to their operations (SPARQL 1.1, 19.8). Pure."""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterable, Mapping
from typing import cast

from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode, Quad

from rosld.ontology.body import BodyError, parse_quads
from rosld.server.http.problem import Problem
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.rewriting import rewrite
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, CheckedText, QueryBounds, check_text, line_and_column
from rosld.server.sparql.syntax.query import QueryParser
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.syntax.tree import Group, Iri, PathStep, Term, Value, Variable
from rosld.server.sparql.syntax.triples import Verb as Predicate
from rosld.server.sparql.update.operations import (
    ChangeData,
    GraphGroup,
    GraphVerb,
    Load,
    ManageGraph,
    Modify,
    Operation,
    QuadTemplate,
    TemplateTerm,
    TemplateVariable,
    Where,
    WithGraph,
    has_blank_nodes,
    variables_of,
)

_UNBOUND = f"unbound_{secrets.token_hex(8)}"
"""A variable that no WHERE binds: projected alone, it makes the solutions countable."""
_OPERATION = "an operation (INSERT, DELETE, WITH, LOAD, CLEAR, DROP, CREATE, ADD, MOVE or COPY)"
_BLOCK = "{ and quads"


def read_update(
    request: UpdateRequest, prefixes: Mapping[str, str], base: str, bounds: QueryBounds, default: str
) -> tuple[Operation, ...]:
    """Return the operations of an update; `prefixes` apply where the text does not declare them.

    Triples without a graph belong to the document `default`. Graphs of the request (`using-graph-uri`) are the dataset
    of each WHERE. Raises the Problems of `check_text`, and 400 for a text that is not an update, or names a dataset
    although the request does.
    """
    data = _read_data(request.text, prefixes, base, bounds, NamedNode(default))
    if data is not None:
        return (data,)
    checked = check_text(request.text, bounds, what="update")
    try:
        return UpdateParser(checked, prefixes, base, bounds.joins, request, default).operations()
    except RecursionError as error:
        raise Problem(400, "The update is nested too deeply: split it.") from error


_DATA = re.compile(
    r"""(?P<prologue>(?:\s|\#[^\r\n]*[\r\n]|PREFIX\s+[^\s<:]*:\s*<[^<>]*>|BASE\s*<[^<>]*>)*)
    (?P<verb>INSERT|DELETE)\s+DATA\s*\{\s*(?P<graph>GRAPH\s*(?:<[^<>]*>|(?!_:)[^\s<>{}:]*:[^\s<>{}]*)\s*\{)?""",
    re.IGNORECASE | re.VERBOSE,
)
"""Beginning of an update of data; no part of it can match one text in two ways, so it takes linear time."""


def _read_data(
    text: str, prefixes: Mapping[str, str], base: str, bounds: QueryBounds, default: NamedNode
) -> ChangeData | None:
    """Return an update that is one INSERT DATA or DELETE DATA of one graph, None for any other.

    Its block is also TriG, which the RDF parser reads in a tenth of the time of `UpdateParser`, so that it may be as
    long as any body. A text that is not TriG, or has more braces, is left to `UpdateParser`. Raises a 400 Problem for a
    syntax error in a text that is too long for that.
    """
    head = _DATA.match(text)
    if head is None:
        return None
    triples = text[head.end() :].rstrip().removesuffix(";")
    for _ in range(2 if head["graph"] else 1):
        triples = triples.rstrip()
        if not triples.endswith("}"):
            return None
        triples = triples[:-1]
    if "{" in triples or "}" in triples or "<<" in triples:
        return None
    used = (f"PREFIX {name}: <{iri}> " for name, iri in prefixes.items() if f"{name}:" in text)
    trig = f"{''.join(used)}{head['prologue']}{head['graph'] or '{'}{triples}}}"
    try:
        quads = parse_quads(trig.encode(), "application/trig", base)
    except BodyError as error:
        if len(text) <= bounds.size:
            return None
        raise Problem(400, f"The update cannot be parsed: {error}.") from error
    if not head["graph"]:
        quads = [Quad(quad.subject, quad.predicate, quad.object, default) for quad in quads]
    if head["verb"].upper() == "INSERT":
        return ChangeData(inserts=tuple(quads))
    if any(isinstance(term, BlankNode) for quad in quads for term in quad):
        return None
    return ChangeData(deletes=tuple(quads))


def rewrite_update(checked: CheckedText, base: str) -> str:
    """Rewrite the text of an update of one graph for a store that encodes some literals (`rewriting.py`).

    Raises a 400 Problem for a text that is not an update.
    """
    parser, _ = _read(checked, base)
    return rewrite(checked.text, parser.literals, parser.expressions)


def read_checked(checked: CheckedText, base: str) -> tuple[Operation, ...]:
    """Return the operations of an update of one graph. Raises a 400 Problem for a text that is not an update."""
    return _read(checked, base)[1]


def _constants(quads: Iterable[QuadTemplate]) -> tuple[Quad, ...]:
    """Return templates without variables as quads."""
    return tuple(
        Quad(cast(NamedNode, subject), cast(NamedNode, predicate), cast(Literal, object), cast(NamedNode | None, graph))
        for subject, predicate, object, graph in quads
    )


def _read(checked: CheckedText, base: str) -> tuple[UpdateParser, tuple[Operation, ...]]:
    parser = UpdateParser(checked, {}, base, DEFAULT_BOUNDS.joins, UpdateRequest(""))
    try:
        return parser, parser.operations()
    except RecursionError as error:
        raise Problem(400, "The update is nested too deeply: split it.") from error


def _patterns(group: Group, graph: str | None) -> tuple[QuadTemplate, ...] | None:
    """Return the patterns of a group whose default graph is `graph`, None if it has others or anything else."""
    found: list[QuadTemplate] = []
    if group.filters or group.tests or group.bindings or group.data:
        return None
    for pattern in group.patterns:
        home = Iri(graph) if group.graph is None and graph else group.graph
        verbs = [pattern.verb] if pattern.verb else [Iri(each) for each in pattern.predicates or ()]
        if not isinstance(home, Iri) or len(verbs) != 1 or pattern.repeated:
            return None
        found.append(
            QuadTemplate(_slot(pattern.subject), _slot(verbs[0]), _slot(pattern.object), NamedNode(home.value))
        )
    for child in group.children:
        inner = _patterns(child, graph)
        if inner is None or not child.joined or child.alternative or (child.graph is not group.graph and not inner):
            return None
        found += inner
    return tuple(found)


def _slot(term: Term) -> TemplateTerm:
    if isinstance(term, Iri):
        return NamedNode(term.value)
    return TemplateVariable(term.name) if isinstance(term, Variable) else term.literal


class UpdateParser(QueryParser):
    """Parser of a complete update."""

    def __init__(
        self,
        checked: CheckedText,
        prefixes: Mapping[str, str],
        base: str,
        max_joins: int,
        request: UpdateRequest,
        default: str | None = None,
    ) -> None:
        super().__init__(checked, prefixes, base, max_joins)
        self._request = request
        self._default = default
        self._prologue = ""
        self._data_labels: set[str] = set()
        self._blank_nodes: dict[str, BlankNode] = {}

    def operations(self) -> tuple[Operation, ...]:
        """Parse the whole text. Raises a 400 Problem for a text that is not an update."""
        found: list[Operation] = []
        while True:
            begin = self.token.start
            self.prologue()
            self._prologue += self.text[begin : self.token.start]
            if self.is_at_end:
                return tuple(found)
            self.joins = 0
            found.append(self._operation())
            if not self.is_at_end:
                self.expect(";", "or the end of the update")

    def _operation(self) -> Operation:
        if self.take("LOAD"):
            return self._load()
        for verb in GraphVerb:
            if self.take(verb.value):
                return self._manage(verb)
        return self._modify(self.expect_iri("the IRI of a graph") if self.take("WITH") else None)

    # Quads

    def _modify(self, graph: str | None) -> ChangeData | Modify:
        """Parse INSERT DATA, DELETE DATA, DELETE WHERE, or DELETE, INSERT or both with a WHERE."""
        keyword = self.key
        if keyword not in ("INSERT", "DELETE"):
            self.fail_expecting("INSERT or DELETE" if graph else _OPERATION)
        self.advance()
        if graph is None and self.take("DATA"):
            return self._data(keyword)
        if graph is None and keyword == "DELETE" and self.take("WHERE"):
            begin = self.token.start
            deletes = self._deletes(None)
            where = self._where(self.text[begin : self.token.start], deletes, None)
            # Outside of GRAPH the pattern matches in all graphs, and the deletion concerns one document.
            is_local = all(isinstance(each.graph, NamedNode) and each.graph.value != self._default for each in deletes)
            return Modify(deletes, (), replace(where, patterns=deletes) if is_local else where)
        deletes = self._deletes(graph) if keyword == "DELETE" else ()
        inserts = self._quads(graph) if keyword == "INSERT" or self.take("INSERT") else ()
        default, named = self._using()
        self.expect("WHERE", "and a group of patterns")
        begin = self.token.start
        matched = self.group(None)
        using = bool(default or named)
        group = self.text[begin : self.token.start]
        where = self._where(group, (*deletes, *inserts), None if using else graph)
        if using:
            where = replace(where, default_graphs=default, named_graphs=named)
        else:
            where = replace(where, patterns=_patterns(matched, graph))
        return Modify(deletes, inserts, where)

    def _data(self, keyword: str) -> ChangeData:
        begin, first = self.token.start, self.position
        if keyword == "DELETE":
            deletes = self._deletes(None)
            self._refuse_holes(deletes, keyword, begin)
            return ChangeData(_constants(deletes))
        inserts = self._quads(None)
        self._refuse_holes(inserts, keyword, begin)
        self._scope_labels(first)
        return ChangeData(inserts=_constants(inserts))

    def _refuse_holes(self, quads: tuple[QuadTemplate, ...], keyword: str, begin: int) -> None:
        if holes := variables_of(quads):
            where = line_and_column(self.text, begin)
            raise Problem(400, f"The {keyword} DATA at {where} cannot contain variables such as ?{holes[0]}.")

    def _deletes(self, graph: str | None) -> tuple[QuadTemplate, ...]:
        """Parse quads without blank nodes."""
        begin = self.token.start
        quads = self._quads(graph)
        if has_blank_nodes(quads):
            where = line_and_column(self.text, begin)
            raise Problem(400, f"The DELETE at {where} cannot contain a blank node: use a variable (SPARQL 1.1, 19.8).")
        return quads

    def _quads(self, graph: str | None) -> tuple[QuadTemplate, ...]:
        """Parse a block of quads; `graph` is the default for triples outside of GRAPH (WITH)."""
        if self.key != "{":
            self.fail_expecting(_BLOCK)
        self.advance()
        found: list[QuadTemplate] = []
        self._blank_nodes.clear()
        home = NamedNode(graph) if (graph := graph or self._default) else None
        while not self.take("}"):
            if self.take("GRAPH"):
                self._quads_of_graph(found)
                continue
            if not self.is_at_triples:
                self.fail_expecting("a triple, GRAPH or }")
            self._triples_into(found, home)
            if self.key not in ("}", "GRAPH"):
                self.expect(".", "or }")
        return tuple(found)

    def _quads_of_graph(self, found: list[QuadTemplate]) -> None:
        if self.token.kind is Kind.VARIABLE:
            name: NamedNode | TemplateVariable = TemplateVariable(self.advance().text[1:])
        else:
            name = NamedNode(self.expect_iri("the IRI of a graph, or a variable"))
        if self.key != "{":
            self.fail_expecting("{ and triples")
        self.advance()
        while not self.take("}"):
            if not self.is_at_triples:
                self.fail_expecting("a triple or }")
            self._triples_into(found, name)
            if self.key != "}":
                self.expect(".", "or }")
        self.take(".")

    def _triples_into(self, found: list[QuadTemplate], graph: NamedNode | TemplateVariable | None) -> None:
        token = self.token

        def add(subject: Term, predicate: Predicate, object: Term) -> None:
            if isinstance(subject, Value):
                raise ValueError("a literal cannot be a subject")
            found.append(QuadTemplate(self._slot(subject), self._predicate(predicate), self._slot(object), graph))

        try:
            self.triples(add, is_pattern=False)
        except ValueError as error:
            self.fail_at(token, f"begins invalid triples: {error}")

    def _predicate(self, predicate: Predicate) -> TemplateTerm:
        if isinstance(predicate, Variable):
            return TemplateVariable(predicate.name)
        assert isinstance(predicate, PathStep)
        return NamedNode(predicate.iri)

    def _slot(self, term: Term) -> TemplateTerm:
        if not isinstance(term, Variable) or not term.is_blank:
            return _slot(term)
        if term.name not in self._blank_nodes:
            self._blank_nodes[term.name] = BlankNode()
        return self._blank_nodes[term.name]

    def _scope_labels(self, first: int) -> None:
        """Refuse a blank node label that an earlier INSERT DATA uses (SPARQL 1.1 Query, 19.6)."""
        found = {token.text: token for token in self.taken_since(first) if token.kind is Kind.BLANK}
        if again := next((token for label, token in found.items() if label in self._data_labels), None):
            where = line_and_column(self.text, again.start)
            words = f"{again.text} at {where} is a label in another INSERT DATA already: choose another"
            raise Problem(400, f"{words} (SPARQL 1.1, 19.6).")
        self._data_labels.update(found)

    # WHERE

    def _using(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        default: list[str] = []
        named: list[str] = []
        while self.take("USING"):
            chosen = named if self.take("NAMED") else default
            chosen.append(self.expect_iri("the IRI of a graph"))
        return tuple(default), tuple(named)

    def _where(self, group: str, quads: tuple[QuadTemplate, ...], graph: str | None) -> Where:
        holes = variables_of(quads)
        if not holes and has_blank_nodes(quads):
            holes = (_UNBOUND,)  # each solution has blank nodes of its own (Update, 3.1.3), so they are counted
        form = f"SELECT {' '.join(f'?{name}' for name in holes)} WHERE" if holes else "ASK"
        query = f"{self._prologue}{form} {group}"
        request = self._request
        if graph is None:
            return Where(query, holes, request.using_graphs, request.using_named_graphs)
        return Where(f"{self._prologue}{form} {{GRAPH <{graph}> {group}}}", holes, with_graph=WithGraph(graph, query))

    # Whole graphs

    def _manage(self, verb: GraphVerb) -> ManageGraph:
        silent = self.take("SILENT")
        if verb in (GraphVerb.ADD, GraphVerb.MOVE, GraphVerb.COPY):
            source = self._graph_or_default()
            self.expect("TO", "and a graph")
            return ManageGraph(verb, self._graph_or_default(), source, silent, self._default)
        if verb is GraphVerb.CREATE or self.key == "GRAPH":
            return ManageGraph(verb, self._named_graph(), None, silent)
        several = next((each for each in GraphGroup if self.take(each.value)), None)
        if several is None:
            self.fail_expecting("GRAPH and its IRI, DEFAULT, NAMED or ALL")
        target = self._default if several is GraphGroup.DEFAULT and self._default else several
        return ManageGraph(verb, target, None, silent, self._default)

    def _graph_or_default(self) -> str | GraphGroup:
        if self.take("DEFAULT"):
            return self._default or GraphGroup.DEFAULT
        self.take("GRAPH")
        return self.expect_iri("DEFAULT or the IRI of a graph")

    def _named_graph(self) -> str:
        self.expect("GRAPH", "and its IRI")
        return self.expect_iri("the IRI of a graph")

    def _load(self) -> Load:
        silent = self.take("SILENT")
        document = self.expect_iri("the IRI of a document")
        return Load(document, self._named_graph() if self.take("INTO") else self._default, silent)
