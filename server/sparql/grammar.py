"""Queries, read just far enough to know what they ask for: triple patterns, and how their groups hang together.

A recursive descent over the grammar of SPARQL 1.1 (its section 19.8), bounded by the lexer's depth. It judges no query:
what it does not know it gives up on (`Unrecognised`), and the store's own parser has the last word.
"""

from __future__ import annotations

from collections.abc import Mapping

from rosld.server.http.problem import Problem
from rosld.server.sparql.cursor import Unrecognised
from rosld.server.sparql.lexer import Bounds, Checked, Kind, Token, place
from rosld.server.sparql.patterns import Group, Iri, Pattern, Reading, Term, Variable, variables
from rosld.server.sparql.triples import TripleReader

_FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_MODIFIERS = ("GROUP", "ORDER", "BY", "HAVING", "LIMIT", "OFFSET", "ASC", "DESC")
_OPERANDS = frozenset({Kind.VARIABLE, Kind.STRING, Kind.LANGUAGE, Kind.NUMBER, Kind.NAME, Kind.IRI})


def read(query: Checked, prefixes: Mapping[str, str], base: str, age: str, bounds: Bounds) -> Reading:
    """Read a query. `age` is the IRI of the function whose argument's values must be known.

    Raises Unrecognised, and Problem 400 for more joins than the bounds allow and for a `<` that reads in two ways.
    """
    return _Reader(query, prefixes, base, age, bounds).query()


class _Reader(TripleReader):
    def __init__(self, query: Checked, prefixes: Mapping[str, str], base: str, age: str, bounds: Bounds) -> None:
        super().__init__(query, prefixes, base, bounds.joins)
        self._age = age
        self._functions: set[str] = set()
        self._constants: set[str] = set()
        self._assigned: set[int] = set()

    # --- the query

    def query(self) -> Reading:
        self.prologue()
        form = self.next()
        if not form.is_word(*_FORMS):
            raise Unrecognised
        name = form.text.upper()
        described: list[Term] = []
        asked = Group()
        if name == "SELECT":
            self._projection(asked)
        elif name == "DESCRIBE":
            described = self._described()
        elif name == "CONSTRUCT" and self.is_next("{"):
            self._template()
        default, named = self._dataset()
        group = self._where(name)
        self._modifiers(asked)
        if self.peek() is not None:
            raise Unrecognised
        group.filters.extend(asked.filters)
        if not described and name == "DESCRIBE":
            described = sorted(set(variables(group)))  # DESCRIBE *
        for term in described:
            self.join()
            group.filters.append(Group(patterns=[Pattern(term, None, self.new())]))
        constants = frozenset(self._constants)
        return Reading(name, group, default, named, frozenset(self._functions), constants)

    def _projection(self, asked: Group) -> None:
        self.take_word("DISTINCT", "REDUCED")
        if self.take("*"):
            return
        while not self.is_word("FROM", "WHERE") and not self.is_next("{"):
            if self.is_next("("):
                self._brackets(asked)
            elif self.next().kind is not Kind.VARIABLE:
                raise Unrecognised

    def _described(self) -> list[Term]:
        described: list[Term] = []
        if self.take("*"):
            return described
        while (token := self.peek()) and token.kind in (Kind.VARIABLE, Kind.IRI, Kind.NAME):
            described.append(self.term())
        if not described:
            raise Unrecognised
        return described

    def _template(self) -> None:
        """What is constructed is joined with nothing."""
        self.expect("{")
        while not self.take("}"):
            if self.next().is_mark("{"):
                raise Unrecognised

    def _dataset(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        default: list[str] = []
        named: list[str] = []
        while self.take_word("FROM"):
            chosen = named if self.take_word("NAMED") else default
            term = self.term()
            if not isinstance(term, Iri):
                raise Unrecognised
            chosen.append(term.value)
        return tuple(default), tuple(named)

    def _where(self, form: str, graph: Term | None = None) -> Group:
        if not self.take_word("WHERE") and not self.is_next("{"):
            if form == "DESCRIBE":
                return Group()
            raise Unrecognised
        return self._group(graph)

    def _modifiers(self, asked: Group) -> None:
        """GROUP BY, HAVING, ORDER BY, LIMIT, OFFSET, VALUES: only their expressions matter."""
        while (token := self.peek()) is not None and not token.is_mark("}"):
            if token.is_word("VALUES"):
                self.skip()
                self._values(Group())
            elif token.is_word(*_MODIFIERS) or token.kind in (Kind.VARIABLE, Kind.NUMBER):
                self.skip()
            else:
                self._call(asked)

    # --- groups

    def _group(self, graph: Term | None) -> Group:
        self.expect("{")
        if self.is_word("SELECT"):
            group = self._subquery(graph)
        else:
            group = Group(graph)
            while not self.is_next("}"):
                self._member(group)
        self.expect("}")
        return group

    def _subquery(self, graph: Term | None) -> Group:
        self.skip()
        asked = Group(graph)
        self._projection(asked)
        group = self._where("SELECT", graph)
        self._modifiers(asked)
        group.filters.extend(asked.filters)
        group.scoped = True
        return Group(graph, children=[group])

    def _member(self, group: Group) -> None:
        token = self.peek()
        if token is None:
            raise Unrecognised
        if token.is_mark("{"):
            self._union(group)
        elif token.is_word("OPTIONAL", "MINUS"):
            self.skip()
            self.join()
            self._child(group, group.graph)
        elif token.is_word("GRAPH"):
            self.skip()
            self.join()
            self._child(group, self.term())
        elif token.is_word("FILTER"):
            self.skip()
            self._call(group)
        elif token.is_word("BIND"):
            self.skip()
            self._bind(group)
            self._assigned.add(id(group))
        elif token.is_word("VALUES"):
            self.skip()
            self.join()
            self._values(group)
        elif token.is_word("SERVICE"):
            self._elsewhere()
        elif not self.take("."):
            group.mixed = group.mixed or id(group) in self._assigned
            self.triples(group)

    def _elsewhere(self) -> None:
        """What another endpoint is asked concerns nothing that is here."""
        self.skip()
        self.take_word("SILENT")
        self.term()
        self.join()
        self._group(None)

    def _child(self, group: Group, graph: Term | None) -> None:
        group.children.append(self._group(graph))

    def _union(self, group: Group) -> None:
        """One group or several alternatives, of which the largest counts."""
        before, most = self.joins, 0
        while True:
            self.joins = before
            self._child(group, group.graph)
            most = max(most, self.joins)
            if not self.take_word("UNION"):
                break
        self.joins = most

    def _bind(self, group: Group) -> None:
        constant, keyword, variable = self.peek(1), self.peek(2), self.peek(3)
        if constant and keyword and variable and constant.kind in (Kind.IRI, Kind.NAME) and keyword.is_word("AS"):
            group.bound[variable.text[1:]] = frozenset({self.iri(constant)})
        self._brackets(group)

    def _values(self, group: Group) -> None:
        """Inline data: variables whose every value is an IRI are bound."""
        single = not self.is_next("(")
        names: list[str] = []
        self.take("(")
        while (token := self.peek()) and token.kind is Kind.VARIABLE:
            names.append(self.next().text[1:])
            if single:
                break
        if not single:
            self.expect(")")
        elif not names:
            raise Unrecognised
        self.expect("{")
        columns: list[set[str] | None] = [set() for _ in names]
        while not self.take("}"):
            if not single:
                self.expect("(")
            for at in range(len(names)):
                _note(columns, at, self._datum())
            if not single:
                self.expect(")")
        for name, column in zip(names, columns, strict=True):
            if column is not None:
                group.bound[name] = frozenset(column)

    def _datum(self) -> str | None:
        if self.take_word("UNDEF"):
            return None
        term = self.term()
        if isinstance(term, Variable):
            raise Unrecognised
        if not isinstance(term, Iri):
            return None
        self._constants.add(term.value)
        return term.value

    # --- expressions

    def _call(self, group: Group) -> None:
        """A constraint: an expression in brackets, EXISTS, or a call of a function."""
        if self.take_word("NOT"):
            pass
        if self.take_word("EXISTS"):
            group.filters.append(self._group(group.graph))
            return
        token = self.peek()
        if token is not None and not token.is_mark("("):
            self._function(self.next(), group)
        self._brackets(group)

    def _brackets(self, group: Group) -> None:
        """An expression from its opening to its closing bracket."""
        self.expect("(")
        operand = False
        while not self.take(")"):
            token = self.peek()
            if token is None or token.is_mark("{", "}", "["):
                raise Unrecognised
            if operand and token.kind is Kind.IRI:
                raise Problem(
                    400,
                    f"{token.text} at {place(self.text, token.start)} can be read as an IRI or as comparisons: "
                    "put a blank after the <.",
                )
            operand = self._expression_token(token, group)

    def _expression_token(self, token: Token, group: Group) -> bool:
        """Take one token of an expression, or all of a bracket; whether an operator must follow."""
        if token.is_word("EXISTS"):
            self.skip()
            group.filters.append(self._group(group.graph))
            return True
        if token.is_mark("("):
            self._brackets(group)
            return True
        self.skip()
        if self.is_next("("):
            self._function(token, group)
        elif token.kind in (Kind.IRI, Kind.NAME):
            self._constants.add(self.iri(token))
        return token.kind in _OPERANDS or token.text.upper().endswith(("TRUE", "FALSE"))

    def _function(self, token: Token, group: Group) -> None:
        """Note a function by its name; what it looks up of a resource is a pattern about that resource."""
        if token.kind is Kind.WORD:
            self._functions.add(token.text.upper())
        elif token.kind in (Kind.IRI, Kind.NAME):
            name = self.iri(token)
            self._functions.add(name)
            if name == self._age:
                group.filters.append(Group(patterns=[Pattern(self._argument(), frozenset({self._age}), self.new())]))

    def _argument(self) -> Term:
        token, close = self.peek(1), self.peek(2)
        if token and close and close.is_mark(")") and token.kind in (Kind.IRI, Kind.NAME, Kind.VARIABLE):
            return Variable(token.text[1:]) if token.kind is Kind.VARIABLE else Iri(self.iri(token))
        return self.new()


def _note(columns: list[set[str] | None], at: int, value: str | None) -> None:
    column = columns[at]
    if column is not None and value is not None:
        column.add(value)
    else:
        columns[at] = None
