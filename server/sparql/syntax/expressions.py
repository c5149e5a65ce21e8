"""Parsing of expressions to trees that keep their positions in the text (SPARQL 1.1, 19.8, rules 107 to 128)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping

from rosld.server.http.problem import Problem
from rosld.server.sparql.math_functions import AGGREGATE_ARGUMENTS
from rosld.server.sparql.message_order import AS_OF, PREVIOUS
from rosld.server.sparql.syntax.cursor import did_you_mean
from rosld.server.sparql.syntax.lexer import CheckedText, line_and_column
from rosld.server.sparql.syntax.token import AGGREGATES, ANY_NUMBER, ARGUMENTS, Kind, Token
from rosld.server.sparql.syntax.tree import (
    Call,
    Choices,
    Constant,
    EvaluatedExpression,
    Exists,
    Expression,
    ExpressionPurpose,
    Group,
    Iri,
    Operand,
    Part,
    Pattern,
    Reference,
    Term,
    Variable,
    parts_of,
    strip_brackets,
)
from rosld.server.sparql.syntax.triples import TripleParser

_COMPARISONS = frozenset({"=", "!=", "<", ">", "<=", ">=", "IN", "NOT"})
_ARITHMETIC = frozenset({"+", "-", "*", "/"})
_LOGIC = frozenset({"&&", "||"})
_SIGNS = frozenset({"!", "+", "-"})
_EXPRESSION = "an expression"
_ARGUMENTS = {**AGGREGATE_ARGUMENTS, AS_OF: (2, 2), PREVIOUS: (1, 1)}
CONSTRAINT = "an expression in brackets, EXISTS, NOT EXISTS or the call of a function"


class ExpressionParser(TripleParser):
    """Parser of expressions; collects the evaluated `expressions`, the called `functions` and the IRIs in `constants`.

    `age` is the IRI of the function that needs live values of its argument: a call of it counts as a pattern on that.
    """

    def __init__(
        self, checked: CheckedText, prefixes: Mapping[str, str], base: str, max_joins: int, age: str = ""
    ) -> None:
        super().__init__(checked, prefixes, base, max_joins)
        self.expressions: list[EvaluatedExpression] = []
        self.functions: set[str] = set()
        self.constants: set[str] = set()
        self._age = age

    @abstractmethod
    def group(self, graph: Term | None) -> Group:
        """Parse a group in braces."""

    def constraint(self, group: Group, expected: str = CONSTRAINT) -> Operand:
        """Parse an expression in brackets, EXISTS or a function call; `group` collects the groups of EXISTS."""
        return self.bracketed(group, expected) if self.key == "(" else self.call(group, expected)

    def bracketed(self, group: Group, expected: str = _EXPRESSION) -> Expression:
        """Parse an expression in brackets."""
        if self.key != "(":
            self.fail_expecting(f"( and {expected}")
        start = self.advance().start
        inner = self.expression(group)
        self.expect(")", "or an operator")
        return Expression(start, self.end, (inner,))

    def call(self, group: Group, expected: str) -> Operand:
        """Parse EXISTS or a function call."""
        token = self.token
        if token.kind is Kind.IRI or token.kind is Kind.NAME:
            return self._call_by_iri(token, self.expect_iri(), group)
        if token.kind is not Kind.WORD or self.key in ("TRUE", "FALSE"):
            self.fail_expecting(expected)
        return self._builtin_call(group)

    def expression(self, group: Group) -> Expression:
        """Parse operands and the operators between them."""
        start = self.token.start
        parts: list[Part] = []
        self._operand(group, parts)
        is_compared = False
        while True:
            key = self.key
            if key in _COMPARISONS:
                if is_compared:
                    self.fail_at(self.token, "compares the result of a comparison: put brackets around one of them")
                is_compared = True
            elif key in _LOGIC:
                is_compared = False
            elif key not in _ARITHMETIC:
                if self.token.kind is Kind.IRI:
                    self._fail_ambiguous()
                return Expression(start, self.end, tuple(parts))
            token = self.advance()
            if key == "IN":
                parts += ("IN", self._choices(token, group))
            elif key == "NOT":
                self.expect("IN", "after NOT")
                parts += ("NOT IN", self._choices(token, group))
            else:
                parts.append(key)
                self._operand(group, parts)

    def _fail_ambiguous(self) -> None:
        """Raise a Problem for a `<` that the store's parser would read as "less than"."""
        where = line_and_column(self.text, self.token.start)
        words = f"{self.token.text} at {where} is ambiguous, an IRI or comparisons: put a space after the <."
        raise Problem(400, words)

    def _choices(self, token: Token, group: Group) -> Choices:
        start = self.token.start
        items = self._arguments(token, ANY_NUMBER, group)
        return Choices(start, self.end, items)

    def _operand(self, group: Group, parts: list[Part]) -> None:
        """Parse an operand and the operators before it."""
        while self.key in _SIGNS and not self._is_at_number:
            parts.append(self.advance().text)
        token = self.token
        kind = token.kind
        if kind is Kind.VARIABLE:
            self.advance()
            parts.append(Reference(token.start, token.end, token.text))
        elif self.key == "(":
            parts.append(self.bracketed(group))
        elif kind is Kind.IRI or kind is Kind.NAME:
            iri = self.expect_iri()
            if self.key == "(":
                parts.append(self._call_by_iri(token, iri, group))
            else:
                self.constants.add(iri)
                parts.append(Constant(token.start, token.end, kind, Iri(iri)))
        elif kind is Kind.BLANK:
            self.fail_at(token, "is a blank node, which is not allowed in an expression")
        elif (literal := self.literal()) is not None:
            parts.append(literal)
        elif kind is Kind.WORD:
            parts.append(self._builtin_call(group))
        else:
            self.fail_unknown(_EXPRESSION)

    @property
    def _is_at_number(self) -> bool:
        number = self.following
        return self.key != "!" and number.kind is Kind.NUMBER and number.start == self.token.end

    # --- calls

    def _builtin_call(self, group: Group) -> Operand:
        """Parse EXISTS, an aggregate or a built-in function."""
        token, name = self.token, self.key
        if name in ("EXISTS", "NOT"):
            self.advance()
            if name == "NOT":
                self.expect("EXISTS", "after NOT")
            group.filters.append(self.group(group.graph))
            return Exists(token.start, self.end)
        if name in AGGREGATES:
            return self._aggregate(group)
        if name not in ARGUMENTS:
            if self.following.is_mark("("):
                near = did_you_mean(name, ARGUMENTS.keys() | AGGREGATES)
                self.fail_at(token, f"is not a SPARQL function{near}")
            self.fail_unknown(_EXPRESSION)
        self.advance()
        arguments = self._arguments(token, ARGUMENTS[name], group)
        return Call(token.start, self.end, name, token.end, arguments)

    def _call_by_iri(self, token: Token, iri: str, group: Group) -> Call:
        arguments = self._arguments(token, _ARGUMENTS.get(iri, ANY_NUMBER), group)
        self.functions.add(iri)
        if iri == self._age:
            about = strip_brackets(arguments[0]) if len(arguments) == 1 else None
            subject: Term = self.new_blank_node()
            if isinstance(about, Reference):
                subject = Variable(about.name[1:])
            elif isinstance(about, Constant):
                subject = about.term
            group.filters.append(Group(patterns=[Pattern(subject, frozenset({iri}), self.new_blank_node())]))
        return Call(token.start, self.end, "", token.end, arguments, iri)

    def _aggregate(self, group: Group) -> Call:
        name = self.key
        token = self.advance()
        self.expect("(", f"after {name}")
        self.take("DISTINCT")
        arguments: tuple[Expression, ...] = ()
        if not (name == "COUNT" and self.take("*")):
            arguments = (self.expression(group),)
        if name == "GROUP_CONCAT" and self.take(";"):
            self.expect("SEPARATOR", "after ;")
            self.expect("=", "after SEPARATOR")
            if self.token.kind is not Kind.STRING:
                self.fail_expecting("a string")
            self.advance()
        self.expect(")", f"after the argument of {name}")
        return Call(token.start, self.end, name, token.end, arguments)

    def _arguments(self, function: Token, bounds: tuple[int, int], group: Group) -> tuple[Expression, ...]:
        if self.key != "(":
            self.fail_expecting(f"( after {function.text}")
        self.advance()
        if function.kind is not Kind.WORD:
            self.take("DISTINCT")
        found: list[Expression] = []
        if not self.take(")"):
            while True:
                if function.is_word("BOUND") and self.token.kind is not Kind.VARIABLE:
                    self.fail_at(self.token, "is unexpected; BOUND needs a variable")
                found.append(self.expression(group))
                if not self.take(","):
                    break
            self.expect(")", "or , or an operator")
        least, limit = bounds
        if not least <= len(found) <= limit:
            wanted = str(least) if least == limit else f"{least} to {limit}"
            self.fail_at(function, f"has {len(found)} arguments and takes {wanted}")
        return tuple(found)

    def add_expression(
        self, operand: Operand, purpose: ExpressionPurpose, start: int = 0, direction: str = "ASC"
    ) -> None:
        """Record an evaluated expression."""
        self.expressions.append(EvaluatedExpression(operand, purpose, start, direction))


def has_aggregate(operand: Operand) -> bool:
    """Whether an expression contains an aggregate."""
    if is_aggregate(operand):
        return True
    return any(map(has_aggregate, parts_of(operand)))


def calls_within(operand: Operand) -> Iterator[Call]:
    """Yield the function calls in an expression, those in EXISTS excluded."""
    if isinstance(operand, Call):
        yield operand
    for part in parts_of(operand):
        yield from calls_within(part)


def ungrouped(operand: Operand) -> Iterator[Reference]:
    """Yield the variables of an expression outside of its aggregates and EXISTS."""
    if isinstance(operand, Reference):
        yield operand
    elif not is_aggregate(operand):
        for part in parts_of(operand):
            yield from ungrouped(part)


def is_aggregate(operand: Operand) -> bool:
    """Whether an expression is the call of an aggregate."""
    return isinstance(operand, Call) and (operand.name in AGGREGATES or operand.iri in AGGREGATE_ARGUMENTS)
