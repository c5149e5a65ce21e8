"""Parsing of queries: groups, sub-queries and solution modifiers (SPARQL 1.1, 19.8, rules 1 to 67).

A recursive descent over the whole grammar, with its notes on labels, scope and groups; the lexer bounds its depth. A
single pass yields the errors of a query, its needs, and the positions to rewrite.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.cursor import Span
from rosld.server.sparql.syntax.expressions import ExpressionParser, has_aggregate, ungrouped
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS, CheckedText, line_and_column
from rosld.server.sparql.syntax.token import FORMS, MEMBERS, MODIFIERS, Kind, Token
from rosld.server.sparql.syntax.tree import (
    Constant,
    ExpressionPurpose,
    Group,
    Iri,
    Operand,
    Pattern,
    Query,
    Reference,
    Slice,
    Term,
    Value,
    Variable,
    message_call,
    strip_brackets,
)

_GROUP = "{ and a group of patterns"
_TRIPLE = "a triple pattern, a keyword such as FILTER or OPTIONAL, or }"
_STARTS_OF_CONDITIONS = frozenset({Kind.VARIABLE, Kind.IRI, Kind.NAME, Kind.WORD})


def parse_query(query: CheckedText, prefixes: Mapping[str, str], base: str, age: str) -> Query:
    """Parse a query; `prefixes` need not be declared. `age` is the IRI of ros:age.

    Raises Problem 400 for syntax errors, with the position and what was expected, and for more joins than the bounds
    allow.
    """
    try:
        return QueryParser(query, prefixes, base, DEFAULT_BOUNDS.joins, age).query()
    except RecursionError as error:
        raise Problem(400, "The query is nested too deeply: split it.") from error


class _Selection(NamedTuple):
    """The projection of a SELECT: variables, with operands for expressions. `items` is None for `*`."""

    select: Token
    items: tuple[tuple[Token, Operand | None], ...] | None


class _Solutions(NamedTuple):
    """Solution modifiers: the variables of GROUP BY (None without it), the operands of all modifiers, and the slice."""

    grouped: frozenset[str] | None
    operands: tuple[Operand, ...]
    slice: Slice | None


class QueryParser(ExpressionParser):
    """Parser of a complete query."""

    _braces = (0, 0)

    def query(self) -> Query:
        """Parse the whole text as one query. Raises a 400 Problem with the position and what was expected there."""
        self.prologue()
        form, name = self.token, self.key
        if self.is_at_end:
            raise Problem(400, "There is no query: it begins with SELECT, ASK, CONSTRUCT or DESCRIBE.")
        if name not in FORMS:
            self.fail_at(form, "is not a query form: SELECT, ASK, CONSTRUCT or DESCRIBE")
        if name == "SELECT":
            outer = Group()
            selection = self._selection(outer)
            default, named = self._dataset()
            where, slice = self._solve(selection, outer, None)
        else:
            slice = None
            self.advance()
            default, named, where = self._ask_construct_or_describe(name)
        if self.take("VALUES"):
            self._values(Group())
        if self.token.kind is not Kind.END:
            self.fail_expecting("the end of the query")
        return Query(
            name,
            where,
            default,
            named,
            frozenset(self.functions),
            frozenset(self.constants),
            tuple(self.literals),
            tuple(self.expressions),
            slice,
            self.text,
            self.taken_since(0),
            form.start,
            self._braces,
        )

    def _ask_construct_or_describe(self, form: str) -> tuple[tuple[str, ...], tuple[str, ...], Group]:
        described: list[Term] = []
        is_everything = is_short = False
        if form == "CONSTRUCT":
            is_short = self.key != "{"
            if not is_short:
                self._template("the template", Group())
        elif form == "DESCRIBE":
            is_everything = self.take("*")
            if not is_everything:
                described = self._describe()
        default, named = self._dataset()
        where = Group()
        if is_short:
            self.expect("WHERE", "or { and a template")
            self._template("CONSTRUCT WHERE", where, is_matched=True)
        elif self.take("WHERE") or self.key == "{" or form != "DESCRIBE":
            where = self.group(None)
        outer = Group()
        self._modifiers(outer)
        where.filters.extend(outer.filters)
        if is_everything:
            described = [Variable(name) for name in sorted(where.visible)]
        for term in described:
            self.count_join()
            where.filters.append(Group(patterns=[Pattern(term, None, self.new_blank_node())]))
        return default, named, where

    def _describe(self) -> list[Term]:
        described: list[Term] = []
        while True:
            if self.token.kind is Kind.VARIABLE:
                described.append(Variable(self.advance().text[1:]))
            else:
                described.append(Iri(self.expect_iri("an IRI, a variable or *")))
            if self.token.kind not in (Kind.VARIABLE, Kind.IRI, Kind.NAME):
                return described

    def _template(self, what: str, group: Group, *, is_matched: bool = False) -> None:
        """Parse triples in braces. A constructed template does not count as a join."""
        if self.key != "{":
            self.fail_expecting(_GROUP)
        self.advance()
        self.triples_to_brace(partial(self.add_path, group) if is_matched else _ignore, what)
        self.advance()

    def _dataset(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        default: list[str] = []
        named: list[str] = []
        while self.take("FROM"):
            chosen = named if self.take("NAMED") else default
            chosen.append(self.expect_iri("the IRI of a graph"))
        return tuple(default), tuple(named)

    # --- SELECT

    def _selection(self, outer: Group) -> _Selection:
        select = self.advance()
        self.take("DISTINCT", "REDUCED")
        if self.take("*"):
            return _Selection(select, None)
        items: list[tuple[Token, Operand | None]] = []
        while True:
            if self.token.kind is Kind.VARIABLE:
                items.append((self.advance(), None))
            elif self.take("("):
                operand = self.expression(outer)
                self.add_expression(operand, ExpressionPurpose.TERM)
                self.expect("AS", "and a variable")
                items.append((self.expect_variable(), operand))
                self.expect(")", "after the variable")
            elif items:
                return _Selection(select, tuple(items))
            else:
                self.fail_expecting("what to select (variables, expressions as (... AS ?x), or *)")

    def _solve(self, selection: _Selection, outer: Group, graph: Term | None) -> tuple[Group, Slice | None]:
        """Parse the group of a SELECT and its modifiers; return the group with the projection as visible variables."""
        self.take("WHERE")
        start = self.token.start
        group = self.group(graph)
        self._braces = (start, self.end - 1)
        solutions = self._modifiers(outer)
        group.filters.extend(outer.filters)
        group.visible = self._selected_variables(selection, group.visible, solutions)
        selected = (operand for _, operand in selection.items or () if operand is not None)
        is_grouped = solutions.grouped is not None or any(map(has_aggregate, (*solutions.operands, *selected)))
        return group, None if is_grouped else solutions.slice

    def _selected_variables(self, selection: _Selection, visible: set[str], solutions: _Solutions) -> set[str]:
        """Return the variables that a SELECT projects, after checks of scope and grouping (18.2.1, 18.2.4.1, 19.8)."""
        items, grouped = selection.items, solutions.grouped
        operands = (*solutions.operands, *(operand for _, operand in items or () if operand is not None))
        if grouped is None and any(map(has_aggregate, operands)):
            grouped = frozenset()
        if items is None:
            if grouped is not None:
                where = line_and_column(self.text, selection.select.start)
                words = f"SELECT * at {where} cannot stand with GROUP BY or an aggregate: name what to select."
                raise Problem(400, words)
            return visible
        new: set[str] = set()
        projected: set[str] = set()
        for variable, operand in items:
            name = variable.text[1:]
            if operand is not None and (name in new or name in (visible if grouped is None else grouped)):
                self.fail_at(variable, "already has a value: choose another name after AS")
            if name in projected:
                self.fail_at(variable, "is selected twice")
            if grouped is not None:
                needed: Iterable[Span] = (variable,) if operand is None else ungrouped(operand)
                self._check_grouped(needed, grouped | new)
            if operand is not None:
                new.add(name)
            projected.add(name)
        return projected

    def _check_grouped(self, needed: Iterable[Span], grouped: Collection[str]) -> None:
        for variable in needed:
            if self.text[variable.start + 1 : variable.end] not in grouped:
                self.fail_at(variable, "is not grouped: name it in GROUP BY, or use an aggregate such as SAMPLE")

    # --- solution modifiers

    def _modifiers(self, outer: Group) -> _Solutions:
        grouped: set[str] | None = None
        operands: list[Operand] = []
        if self.take("GROUP"):
            self.expect("BY", "after GROUP")
            grouped = {name for name in self._group_variables(outer) if name is not None}
        if self.take("HAVING"):
            while True:
                operands.append(self.constraint(outer))
                self.add_expression(operands[-1], ExpressionPurpose.TEST)
                if not self._is_at_condition:
                    break
        first, is_descending = None, False
        if self.take("ORDER"):
            self.expect("BY", "after ORDER")
            is_descending = self.key == "DESC"
            ordered = self._order_operands(outer)
            first = ordered[0]
            operands += ordered
        numbers: dict[str, int] = {}
        slices = {"LIMIT", "OFFSET"}
        while self.key in slices:
            keyword = self.key
            slices.remove(keyword)
            self.advance()
            if self.token.kind is not Kind.NUMBER or not self.token.text.isdigit():
                self.fail_expecting(f"the number of {keyword}")
            numbers[keyword] = int(self.advance().text)
        slice = None
        if "LIMIT" in numbers:
            slice = Slice(numbers["LIMIT"], numbers.get("OFFSET", 0), first, is_descending)
        return _Solutions(None if grouped is None else frozenset(grouped), tuple(operands), slice)

    def _group_variables(self, outer: Group) -> list[str | None]:
        """Parse the variables of GROUP BY, None for expressions without a name."""
        names: list[str | None] = []
        while True:
            if self.token.kind is Kind.VARIABLE:
                names.append(self.advance().text[1:])
            elif self.take("("):
                self.add_expression(self.expression(outer), ExpressionPurpose.TERM)
                names.append(self.expect_variable().text[1:] if self.take("AS") else None)
                self.expect(")", "after the expression")
            else:
                self.add_expression(self.call(outer, "a variable or an expression to group by"), ExpressionPurpose.TERM)
            if not self._is_at_condition:
                return names

    def _order_operands(self, outer: Group) -> list[Operand]:
        operands: list[Operand] = []
        while True:
            start, direction = self.token.start, "ASC"
            if self.token.kind is Kind.VARIABLE:
                token = self.advance()
                operand: Operand = Reference(token.start, token.end, token.text)
            elif self.key in ("ASC", "DESC"):
                direction = self.key
                self.advance()
                operand = self.bracketed(outer, "the expression to order by")
            else:
                operand = self.constraint(outer, "a variable, ASC(...), DESC(...) or an expression in brackets")
            operands.append(operand)
            self.add_expression(operand, ExpressionPurpose.ORDER, start, direction)
            if not self._is_at_condition:
                return operands

    @property
    def _is_at_condition(self) -> bool:
        return self.key == "(" or (self.token.kind in _STARTS_OF_CONDITIONS and self.key not in MODIFIERS)

    # --- groups

    def group(self, graph: Term | None) -> Group:
        """Parse a group in braces, or a sub-query."""
        if self.key != "{":
            self.fail_expecting(_GROUP)
        self.advance()
        self.block += 1
        if self.key == "SELECT":
            group = self._subquery(graph)
        else:
            group = Group(graph)
            self._members(group)
            self.advance()
        self.block += 1
        return group

    def _subquery(self, graph: Term | None) -> Group:
        outer = Group(graph)
        inner, _ = self._solve(self._selection(outer), outer, graph)
        inner.scoped = True
        if self.take("VALUES"):
            self._values(Group())
        self.expect("}", "after the sub-query")
        return Group(graph, children=[inner], visible=inner.visible)

    def _members(self, group: Group) -> None:
        add = partial(self.add_path, group)
        while self.key != "}":
            if self.is_at_triples:
                group.mixed = group.mixed or group.assigned
                self.triples(add, is_pattern=True)
                if self.key not in ("{", "}") and self.key not in MEMBERS:
                    self.expect(".", "or }")
                continue
            self._member(group)
            self.take(".")

    def _member(self, group: Group) -> None:
        key = self.key
        if key == "{":
            self._union(group)
        elif key not in MEMBERS:
            self.fail_expecting(_TRIPLE)
        elif key == "FILTER":
            self.advance()
            group.tests.append(_without_aggregate(self.constraint(group)))
            self.add_expression(group.tests[-1], ExpressionPurpose.TEST)
            return  # triples on both sides form one block
        else:
            self.advance()
            if key == "BIND":
                self._bind(group)
            elif key == "SERVICE":
                self._service(group)
            elif key == "VALUES":
                self.count_join()
                self._values(group)
            else:
                self.count_join()
                graph = self._graph(group) if key == "GRAPH" else group.graph
                child = self.group(graph)
                child.joined, child.given = key == "GRAPH", _bound(group)
                group.children.append(child)
                if key != "MINUS":
                    group.visible |= child.visible
        self.block += 1

    def _union(self, group: Group) -> None:
        """Parse one group or several alternatives; the largest alternative counts as joins."""
        before, limit = self.joins, 0
        alternatives: list[Group] = []
        while True:
            self.joins = before
            child = self.group(group.graph)
            child.joined, child.given = True, _bound(group)
            alternatives.append(child)
            group.children.append(child)
            group.visible |= child.visible
            limit = max(limit, self.joins)
            if not self.take("UNION"):
                break
        for each in alternatives:
            each.alternative = len(alternatives) > 1
        self.joins = limit

    def _graph(self, group: Group, expected: str = "the IRI of a graph, or a variable") -> Term:
        if self.token.kind is Kind.VARIABLE:
            variable = Variable(self.advance().text[1:])
            group.visible.add(variable.name)
            return variable
        return Iri(self.expect_iri(expected))

    def _service(self, group: Group) -> None:
        """Parse SERVICE, which concerns no local graphs and is sent unchanged."""
        self.take("SILENT")
        self._graph(group, "an IRI")
        self.count_join()
        literals, places = len(self.literals), len(self.expressions)
        functions, constants = set(self.functions), set(self.constants)
        group.visible |= self.group(None).visible
        del self.literals[literals:]
        del self.expressions[places:]
        self.functions, self.constants = functions, constants

    def _bind(self, group: Group) -> None:
        self.expect("(", "after BIND")
        operand = _without_aggregate(self.expression(group))
        self.add_expression(operand, ExpressionPurpose.TERM)
        self.expect("AS", "and a variable")
        variable = self.expect_variable()
        name = variable.text[1:]
        if name in group.visible:
            self.fail_at(variable, "already has a value before this BIND: choose another name after AS")
        self.expect(")", "after the variable of BIND")
        group.visible.add(name)
        group.bindings.append((name, operand))
        group.assigned = True
        group.mixed = group.mixed or isinstance(strip_brackets(operand), Constant)

    def _values(self, group: Group) -> None:
        names: list[str] = []
        is_single = not self.take("(")
        if is_single:
            names.append(self.expect_variable("a variable, or several in brackets,").text[1:])
        else:
            while not self.take(")"):
                names.append(self.expect_variable("a variable or )").text[1:])
        self.expect("{", "and the values")
        rows: list[Sequence[Iri | Value | None]] = []
        while not self.take("}"):
            rows.append([self._datum("a value or }")] if is_single else self._row(len(names)))
        group.visible.update(names)
        for place, name in enumerate(names):
            values = {row[place] for row in rows}
            known = frozenset(each for each in values if each is not None)
            group.data.append((name, None if None in values else known))

    def _row(self, length: int) -> Sequence[Iri | Value | None]:
        row = self.expect("(", "and the values of a row, or }")
        found: list[Iri | Value | None] = []
        while not self.take(")"):
            found.append(self._datum("a value or )"))
        if len(found) != length:
            self.fail_at(row, f"begins a row with {len(found)} values for {length} variables")
        return found

    def _datum(self, expected: str) -> Iri | Value | None:
        """Parse a value of VALUES, None for UNDEF."""
        token = self.token
        if token.kind is Kind.VARIABLE:
            self.fail_at(token, "is not allowed in VALUES, which takes IRIs, literals or UNDEF")
        if token.kind is Kind.BLANK:
            self.fail_at(token, "is a blank node, which is not allowed in VALUES")
        if self.take("UNDEF"):
            return None
        term = self.term(expected)
        if isinstance(term, Iri):
            self.constants.add(term.value)
        assert not isinstance(term, Variable)
        return term


def _bound(group: Group) -> frozenset[str]:
    """Return the variables bound by the patterns of a group parsed so far, and those that are recorded messages."""
    terms = (term for each in group.patterns for term in (each.subject, each.object))
    return frozenset(term.name for term in terms if isinstance(term, Variable)).union(
        name for name, operand in group.bindings if message_call(operand) is not None
    )


def _without_aggregate(operand: Operand) -> Operand:
    """Return an operand. Raises a 400 Problem for an aggregate in it, as it is not over a group."""
    if has_aggregate(operand):
        raise Problem(400, "FILTER and BIND take no aggregates: compute them in SELECT, or compare them in HAVING.")
    return operand


def _ignore(*_: object) -> None:
    """Ignore the triples of a template, which match nothing."""
