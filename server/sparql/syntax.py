"""What is wrong with the syntax of a query, in words for people: which token, where, what was expected. Pure.

The store's parser decides what is a query, and its words for what is none are lists of characters. So where a query is
refused it is read once more here, by the grammar of SPARQL 1.1 (19.8) and its notes on blank nodes, scope and groups.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from typing import NamedTuple, NoReturn

from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import Kind, Token, lexical_error, names_unescaped, place, tokens
from rosld.server.store import QueryError


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split())


_FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_AGGREGATES = frozenset({"COUNT", "SUM", "MIN", "MAX", "AVG", "SAMPLE", "GROUP_CONCAT"})
_ANY = (0, 1000)
_ARGUMENTS = {
    **dict.fromkeys(_names("NOW RAND UUID STRUUID"), (0, 0)),
    **dict.fromkeys(
        _names(
            "STR LANG DATATYPE IRI URI ABS CEIL FLOOR ROUND STRLEN UCASE LCASE ENCODE_FOR_URI YEAR MONTH DAY HOURS "
            "MINUTES SECONDS TIMEZONE TZ MD5 SHA1 SHA256 SHA384 SHA512 ISIRI ISURI ISBLANK ISLITERAL ISNUMERIC BOUND"
        ),
        (1, 1),
    ),
    **dict.fromkeys(_names("LANGMATCHES CONTAINS STRSTARTS STRENDS STRBEFORE STRAFTER STRLANG STRDT SAMETERM"), (2, 2)),
    **dict.fromkeys(_names("REGEX SUBSTR"), (2, 3)),
    **dict.fromkeys(_names("COALESCE CONCAT"), _ANY),
    "BNODE": (0, 1),
    "IF": (3, 3),
    "REPLACE": (3, 4),
}
"""The least and the most arguments of each function that has a name of its own (rule 121)."""
_BEYOND = frozenset(_names("TRIPLE SUBJECT PREDICATE OBJECT ISTRIPLE LANGDIR HASLANG HASLANGDIR STRLANGDIR ADJUST"))
"""Functions of SPARQL 1.2 that the store may know."""
_MEMBERS = ("OPTIONAL", "MINUS", "GRAPH", "SERVICE", "FILTER", "BIND", "VALUES", "LATERAL")
_AFTER = ("GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "VALUES")
_OPERATORS = frozenset({"||", "&&", "=", "!=", "<", ">", "<=", ">=", "+", "-", "*", "/"})
_COMPARISONS = frozenset({"=", "!=", "<", ">", "<=", ">="})
_TERMS = frozenset({Kind.VARIABLE, Kind.IRI, Kind.NAME, Kind.BLANK, Kind.STRING, Kind.NUMBER})
_LONGEST = 40

_GROUP = "{ and a group of patterns"
_TRIPLE = "a triple pattern, a keyword such as FILTER or OPTIONAL, or }"
_EXPRESSION = "an expression"
_CONSTRAINT = "an expression in brackets, EXISTS, NOT EXISTS or the call of a function"
_IRI = "an IRI"
_NODE = "a variable, an IRI, a blank node or a literal"


def refusal(error: QueryError, text: str, prefixes: Collection[str]) -> Problem:
    """Why the store does not take a query: what is wrong with it, or else where, in words for people."""
    if wrong := syntax_error(text, prefixes):
        return Problem(400, wrong)
    where = place_of(error)
    return Problem(400, f"The query is not understood{where}." if where else f"The query is refused: {error}.")


def place_of(error: Exception) -> str:
    """Where the store's parser gave up (` at 1:19`), without its list of what it would have gone on with."""
    where = _WHERE.match(str(error))
    return f" at {where[1]}" if where else ""


_WHERE = re.compile(r"error at (\d+:\d+): ")


def syntax_error(text: str, prefixes: Collection[str]) -> str | None:
    """One sentence that says what is wrong with a query, None where nothing wrong is found.

    `prefixes` need not be declared.
    """
    text = names_unescaped(text)
    meaning = []
    for token in tokens(text):
        if wrong := lexical_error(token, text):
            return wrong
        if token.kind is not Kind.SPACE and token.kind is not Kind.COMMENT:
            meaning.append(token)
    try:
        _Reader(text, meaning, prefixes).query()
    except _Wrong as wrong:
        return wrong.words
    except RecursionError:
        return None
    return None


class _Wrong(Exception):
    """What was looked for is found."""

    def __init__(self, words: str) -> None:
        super().__init__(words)
        self.words = words


class _Used(NamedTuple):
    """The variables of an expression outside of its aggregates, and whether it has any of these."""

    variables: tuple[Token, ...] = ()
    aggregates: bool = False


class _Projection(NamedTuple):
    """What a SELECT tells: variables, or expressions with the variables that they are given to. Neither for `*`."""

    everything: bool
    items: tuple[tuple[Token, _Used | None], ...]


class _Solution(NamedTuple):
    """What GROUP BY, HAVING and ORDER BY say: variables that are grouped by (None: there is no GROUP BY)."""

    grouped: frozenset[str] | None
    used: _Used


class _Reader:
    def __init__(self, text: str, found: list[Token], prefixes: Collection[str]) -> None:
        self._text = text
        self._tokens = found
        self._at = 0
        self._prefixes = set(prefixes)
        self._open: list[Token] = []
        self._labels: dict[str, int] = {}
        self._block = 0

    # --- tokens

    def _peek(self, ahead: int = 0) -> Token | None:
        at = self._at + ahead
        return self._tokens[at] if at < len(self._tokens) else None

    def _next(self, expected: str) -> Token:
        token = self._peek()
        if token is None:
            self._unexpected(expected)
        self._at += 1
        if token.is_mark("(", "[", "{"):
            self._open.append(token)
        elif token.is_mark(")", "]", "}") and self._open:
            self._open.pop()
        return token

    def _is_mark(self, *marks: str) -> bool:
        token = self._peek()
        return token is not None and token.is_mark(*marks)

    def _is_word(self, *words: str) -> bool:
        token = self._peek()
        return token is not None and token.is_word(*words)

    def _take_mark(self, *marks: str) -> bool:
        return self._is_mark(*marks) and bool(self._next(""))

    def _take_word(self, *words: str) -> bool:
        return self._is_word(*words) and bool(self._next(""))

    def _mark(self, mark: str, why: str) -> None:
        if not self._take_mark(mark):
            self._unexpected(f"{mark} {why}".rstrip())

    def _word(self, word: str, why: str) -> None:
        if not self._take_word(word):
            self._unexpected(f"{word} {why}".rstrip())

    def _variable(self, expected: str) -> Token:
        token = self._peek()
        if token is None or token.kind is not Kind.VARIABLE:
            self._unexpected(expected)
        return self._next(expected)

    # --- words

    def _where_is(self, token: Token) -> str:
        return f"{_short(token.text)} at {place(self._text, token.start)}"

    def _wrong(self, token: Token, words: str) -> NoReturn:
        raise _Wrong(f"{self._where_is(token)} {words}.")

    def _unexpected(self, expected: str) -> NoReturn:
        token = self._peek()
        if token is None:
            words = f"The query ends where {expected} is expected"
            if self._open:
                words += f", and {self._where_is(self._open[-1])} is not closed"
            raise _Wrong(f"{words}.")
        if token.is_mark("<"):
            self._wrong(token, "begins no IRI: it has no end, or a blank, a quote or a bracket in it")
        if token.kind is Kind.WORD and not token.is_word("A", "TRUE", "FALSE") and not _is_known(token):
            self._wrong(token, f"is no keyword of SPARQL{_like(token.text, _KEYWORDS)}, where {expected} is expected")
        self._wrong(token, f"stands where {expected} is expected")

    # --- the query

    def query(self) -> None:
        """Read all of it."""
        self._prologue()
        form = self._peek()
        if form is None:
            raise _Wrong("There is no query: it begins with SELECT, ASK, CONSTRUCT or DESCRIBE.")
        if not form.is_word(*_FORMS):
            self._wrong(form, "is no query form: SELECT, ASK, CONSTRUCT or DESCRIBE")
        if form.is_word("SELECT"):
            self._select()
        else:
            self._next("")
            self._other(form.text.upper())
        self._trailing_values()
        if self._peek() is not None:
            self._unexpected("the end of the query")

    def _prologue(self) -> None:
        while True:
            if self._take_word("PREFIX"):
                expected = "the name of a prefix, such as ex:,"
                name = self._next(expected)
                if name.kind is not Kind.NAME or name.text.index(":") != len(name.text) - 1:
                    self._wrong(name, "is no name of a prefix: it ends in a colon, such as ex:, and has no other")
                if (iri := self._peek()) is None or iri.kind is not Kind.IRI:
                    self._unexpected(f"the IRI of {name.text} in <>")
                self._next("")
                self._prefixes.add(name.text[:-1])
            elif self._take_word("BASE"):
                if (iri := self._peek()) is None or iri.kind is not Kind.IRI:
                    self._unexpected("the IRI of BASE in <>")
                self._next("")
            else:
                return

    def _other(self, form: str) -> None:
        shortened = False
        if form == "CONSTRUCT":
            shortened = not self._is_mark("{")
            if not shortened:
                self._template("the template")
        elif form == "DESCRIBE":
            self._described()
        self._dataset()
        if shortened:
            self._word("WHERE", "or { and a template")
            self._template("CONSTRUCT WHERE")
        elif self._take_word("WHERE") or self._is_mark("{") or form != "DESCRIBE":
            self._group()
        self._modifiers()

    def _described(self) -> None:
        if self._take_mark("*"):
            return
        expected = "an IRI, a variable or *"
        while True:
            token = self._peek()
            if token is not None and token.kind is Kind.VARIABLE:
                self._next("")
            else:
                self._iri(expected)
            following = self._peek()
            if following is None or following.kind not in (Kind.VARIABLE, Kind.IRI, Kind.NAME):
                return

    def _select(self) -> frozenset[str]:
        """A SELECT with all that belongs to it; the variables that it tells."""
        select = self._next("SELECT")
        self._take_word("DISTINCT", "REDUCED")
        told = self._projection()
        self._dataset()
        self._take_word("WHERE")
        visible = self._group()
        solution = self._modifiers()
        return self._told(select, told, visible, solution)

    def _projection(self) -> _Projection:
        if self._take_mark("*"):
            return _Projection(True, ())
        items: list[tuple[Token, _Used | None]] = []
        while True:
            token = self._peek()
            if token is not None and token.kind is Kind.VARIABLE:
                items.append((self._next(""), None))
            elif self._take_mark("("):
                used = self._expression()
                self._word("AS", "and a variable")
                items.append((self._variable("a variable"), used))
                self._mark(")", "after the variable")
            elif items:
                return _Projection(False, tuple(items))
            else:
                self._unexpected("what to select (variables, expressions as (... AS ?x), or *)")

    def _told(self, select: Token, told: _Projection, visible: frozenset[str], solution: _Solution) -> frozenset[str]:
        used = (each for _, each in told.items if each is not None)
        grouped = solution.grouped
        if grouped is None and (solution.used.aggregates or any(each.aggregates for each in used)):
            grouped = frozenset()
        if told.everything:
            if grouped is not None:
                where = place(self._text, select.start)
                raise _Wrong(f"SELECT * at {where} cannot stand with GROUP BY or an aggregate: name what to select.")
            return visible
        new: set[str] = set()
        for variable, expression in told.items:
            name = variable.text[1:]
            needed = (variable,) if expression is None else expression.variables
            if expression is not None and (name in visible or name in new):
                self._wrong(variable, "has a value already: choose another name after AS")
            if grouped is not None:
                self._check_grouped(needed, grouped | new)
            if expression is not None:
                new.add(name)
        return frozenset(variable.text[1:] for variable, _ in told.items)

    def _check_grouped(self, needed: Iterable[Token], grouped: Collection[str]) -> None:
        for variable in needed:
            if variable.text[1:] not in grouped:
                self._wrong(variable, "is not grouped by: name it in GROUP BY, or use an aggregate such as SAMPLE")

    def _dataset(self) -> None:
        while self._take_word("FROM"):
            self._take_word("NAMED")
            self._iri("the IRI of a graph")

    def _modifiers(self) -> _Solution:
        grouped: set[str] | None = None
        used = _Used()
        if self._take_word("GROUP"):
            self._word("BY", "after GROUP")
            grouped = set()
            expected = "a variable or an expression to group by"
            while True:
                if (variable := self._peek()) and variable.kind is Kind.VARIABLE:
                    grouped.add(self._next("").text[1:])
                elif self._take_mark("("):
                    self._expression()
                    if self._take_word("AS"):
                        grouped.add(self._variable("a variable").text[1:])
                    self._mark(")", "after the expression")
                else:
                    self._call(expected)
                if not self._goes_on():
                    break
        if self._take_word("HAVING"):
            used = self._constraint()
            while self._goes_on():
                used = _joined(used, self._constraint())
        if self._take_word("ORDER"):
            self._word("BY", "after ORDER")
            used = _joined(used, self._order())
        self._slices()
        return _Solution(None if grouped is None else frozenset(grouped), used)

    def _order(self) -> _Used:
        used = _Used()
        while True:
            if (variable := self._peek()) and variable.kind is Kind.VARIABLE:
                self._next("")
            elif self._take_word("ASC", "DESC"):
                used = _joined(used, self._bracketed("the expression to order by"))
            else:
                used = _joined(used, self._constraint("a variable, ASC(...), DESC(...) or an expression in brackets"))
            if not self._goes_on() and not self._is_word("ASC", "DESC"):
                return used

    def _goes_on(self) -> bool:
        """Whether another condition follows."""
        token = self._peek()
        if token is None or token.is_word(*_AFTER):
            return False
        return token.is_mark("(") or token.kind in (Kind.VARIABLE, Kind.IRI, Kind.NAME, Kind.WORD)

    def _slices(self) -> None:
        while self._is_word("LIMIT", "OFFSET"):
            keyword = self._next("")
            number = self._peek()
            if number is None or number.kind is not Kind.NUMBER or not number.text.isdigit():
                self._unexpected(f"the number of {keyword.text.upper()}")
            self._next("")

    def _trailing_values(self) -> None:
        if self._take_word("VALUES"):
            self._values()

    # --- groups

    def _group(self) -> frozenset[str]:
        """A group; the variables that are in scope after it (SPARQL 1.1, 18.2.1)."""
        if not self._is_mark("{"):
            self._unexpected(_GROUP)
        self._next("")
        self._block += 1
        if self._is_word("SELECT"):
            visible = self._select()
            self._trailing_values()
            self._mark("}", "after the sub-query")
        else:
            visible = self._members()
        self._block += 1
        return visible

    def _members(self) -> frozenset[str]:
        visible: set[str] = set()
        while not self._take_mark("}"):
            token = self._peek()
            if token is not None and _begins_triples(token):
                self._triples(visible)
                following = self._peek()
                if not (self._is_mark("{", "}") or (following and following.is_word(*_MEMBERS))):
                    self._mark(".", "or }")
                continue
            self._member(token, visible)
            self._take_mark(".")
        return frozenset(visible)

    def _member(self, token: Token | None, visible: set[str]) -> None:
        if self._is_mark("{"):
            visible |= self._group()
            while self._take_word("UNION"):
                visible |= self._group()
        elif token is None or not self._take_word(*_MEMBERS):
            self._unexpected(_TRIPLE)
        elif token.is_word("FILTER"):
            self._constraint()
            return  # triples around it are one block
        elif token.is_word("OPTIONAL", "LATERAL"):
            visible |= self._group()
        elif token.is_word("MINUS"):
            self._group()
        elif token.is_word("GRAPH", "SERVICE"):
            if token.is_word("SERVICE"):
                self._take_word("SILENT")
            if (name := self._peek()) and name.kind is Kind.VARIABLE:
                visible.add(self._next("").text[1:])
            else:
                self._iri("the IRI of a graph, or a variable" if token.is_word("GRAPH") else _IRI)
            visible |= self._group()
        elif token.is_word("BIND"):
            self._bind(visible)
        else:
            visible |= self._values()
        self._block += 1

    def _bind(self, visible: set[str]) -> None:
        self._mark("(", "after BIND")
        self._expression()
        self._word("AS", "and a variable")
        variable = self._variable("a variable")
        if variable.text[1:] in visible:
            self._wrong(variable, "has a value already, before this BIND: choose another name after AS")
        visible.add(variable.text[1:])
        self._mark(")", "after the variable of BIND")

    def _values(self) -> frozenset[str]:
        names: list[str] = []
        single = not self._take_mark("(")
        if single:
            names.append(self._variable("a variable, or several in brackets,").text[1:])
        else:
            while not self._take_mark(")"):
                names.append(self._variable("a variable or )").text[1:])
        self._mark("{", "and the values")
        while not self._take_mark("}"):
            if single:
                self._datum("a value or }")
                continue
            row = self._peek()
            self._mark("(", "and the values of a row, or }")
            count = 0
            while not self._take_mark(")"):
                self._datum("a value or )")
                count += 1
            if count != len(names):
                assert row is not None
                self._wrong(row, f"begins a row of {count} values for {len(names)} variables")
        return frozenset(names)

    def _datum(self, expected: str) -> None:
        token = self._peek()
        if token is not None and token.kind is Kind.VARIABLE:
            self._wrong(token, "stands among the values of VALUES, which are IRIs, literals or UNDEF")
        if token is not None and token.kind is Kind.BLANK:
            self._wrong(token, "is a blank node, which cannot be a value of VALUES")
        if not self._take_word("UNDEF"):
            self._term(expected)

    # --- triples

    def _template(self, what: str) -> None:
        if not self._is_mark("{"):
            self._unexpected(_GROUP)
        self._next("")
        self._block += 1
        while not self._take_mark("}"):
            token = self._peek()
            if token is not None and (token.is_mark("{") or token.is_word(*_MEMBERS)):
                self._wrong(token, f"cannot stand in {what}: there are triples only")
            if token is None or not _begins_triples(token):
                self._unexpected("a triple or }")
            self._triples(set(), simple=True)
            if not self._is_mark("}"):
                self._mark(".", "or }")
        self._block += 1

    def _triples(self, visible: set[str], *, simple: bool = False) -> None:
        """Triples of one subject."""
        bare = self._is_mark("[", "(")
        empty = bare and (following := self._peek(1)) is not None and following.is_mark("]", ")")
        self._node(visible, "a subject", simple)
        if not (bare and not empty and (self._peek() is None or self._is_mark(".", "}"))):
            self._properties(visible, simple)

    def _properties(self, visible: set[str], simple: bool) -> None:
        while True:
            self._verb(visible, simple)
            while True:
                self._node(visible, f"the object of a triple ({_NODE})", simple)
                if not self._take_mark(","):
                    break
            if not self._take_mark(";"):
                return
            while self._take_mark(";"):
                pass
            token = self._peek()
            if token is None or token.is_mark(".", "]", "}", "{") or token.is_word(*_MEMBERS):
                return

    def _verb(self, visible: set[str], simple: bool) -> None:
        token = self._peek()
        if token is not None and token.kind is Kind.VARIABLE:
            visible.add(self._next("").text[1:])
        elif not simple:
            self._path()
        elif not self._take_word("A"):
            self._iri("a predicate (an IRI, a variable or a)")

    def _node(self, visible: set[str], expected: str, simple: bool) -> None:
        if self._take_mark("["):
            if not self._take_mark("]"):
                self._properties(visible, simple)
                self._mark("]", "or ; and a predicate")
        elif self._take_mark("("):
            while not self._take_mark(")"):
                self._node(visible, f"{_NODE}, or )", simple)
        elif (token := self._peek()) and token.kind is Kind.VARIABLE:
            visible.add(self._next("").text[1:])
        elif token and token.kind is Kind.BLANK:
            self._label(self._next(""))
        else:
            self._term(expected)

    def _label(self, token: Token) -> None:
        """A label of a blank node holds within one block of triples (SPARQL 1.1, 5.1.1)."""
        if self._labels.setdefault(token.text, self._block) != self._block:
            self._wrong(token, "stands in another group of triples already: use a variable for what is the same in two")

    def _term(self, expected: str) -> None:
        token = self._peek()
        if token is None or (token.kind not in _TERMS and not token.is_mark("+", "-")):
            if token is not None and token.is_word("TRUE", "FALSE"):
                self._next("")
                return
            self._bare(token, expected)
        elif token.kind is Kind.STRING:
            self._string()
        elif self._take_mark("+", "-"):
            if (number := self._peek()) is None or number.kind is not Kind.NUMBER:
                self._unexpected("a number")
            self._next("")
        elif token.kind is Kind.NUMBER:
            self._next("")
        else:
            self._iri(expected)

    def _bare(self, token: Token | None, expected: str) -> NoReturn:
        if token is not None and token.kind is Kind.WORD and not _is_known(token):
            hint = "put it in quotes, or write it as a variable (?) or with a prefix"
            self._wrong(token, f"is no term{_like(token.text, _KEYWORDS)}: {hint}")
        self._unexpected(expected)

    def _string(self) -> None:
        self._next("")
        token = self._peek()
        if token is not None and token.kind is Kind.LANGUAGE:
            self._next("")
        elif self._take_mark("^^"):
            self._iri("the IRI of a datatype")

    def _iri(self, expected: str) -> None:
        token = self._peek()
        if token is None or token.kind not in (Kind.IRI, Kind.NAME):
            self._unexpected(expected)
        self._next("")
        if token.kind is Kind.NAME:
            prefix = token.text.partition(":")[0]
            if prefix not in self._prefixes:
                where, near = place(self._text, token.start), _like(prefix, self._prefixes, ":")
                raise _Wrong(f"The prefix {_short(prefix)}: is not declared{near}, at {where}.")

    # --- paths

    def _path(self) -> None:
        while True:
            while True:
                self._take_mark("^")
                self._path_primary()
                self._take_mark("*", "+", "?")
                if not self._take_mark("/"):
                    break
            if not self._take_mark("|"):
                return

    def _path_primary(self) -> None:
        expected = "a predicate (an IRI, a variable, a or a path)"
        if self._take_mark("("):
            self._path()
            self._mark(")", "after the path")
        elif self._take_mark("!"):
            if not self._take_mark("("):
                self._negated()
                return
            while not self._take_mark(")"):
                self._negated()
                if not self._is_mark(")"):
                    self._mark("|", "or )")
        elif not self._take_word("A"):
            self._iri(expected)

    def _negated(self) -> None:
        self._take_mark("^")
        if not self._take_word("A"):
            self._iri("a predicate (an IRI or a)")

    # --- expressions

    def _constraint(self, expected: str = _CONSTRAINT) -> _Used:
        return self._bracketed(expected) if self._is_mark("(") else self._call(expected)

    def _bracketed(self, expected: str) -> _Used:
        if not self._is_mark("("):
            self._unexpected(f"( and {expected}")
        self._next("")
        used = self._expression()
        self._mark(")", "or an operator")
        return used

    def _call(self, expected: str) -> _Used:
        token = self._peek()
        if token is not None and token.kind in (Kind.IRI, Kind.NAME):
            self._iri(expected)
            return self._arguments(token, _ANY)
        if token is None or token.kind is not Kind.WORD or token.is_word("TRUE", "FALSE"):
            self._unexpected(expected)
        return self._named(token)

    def _named(self, token: Token) -> _Used:
        """EXISTS, an aggregate or a function that has a name of its own."""
        if token.is_word("EXISTS", "NOT"):
            self._next("")
            if token.is_word("NOT"):
                self._word("EXISTS", "after NOT")
            self._group()
            return _Used()
        name = token.text.upper()
        if name in _AGGREGATES:
            return self._aggregate()
        if name not in _ARGUMENTS and name not in _BEYOND:
            following = self._peek(1)
            if following is not None and following.is_mark("("):
                self._wrong(token, f"is no function of SPARQL{_like(name, _ARGUMENTS.keys() | _AGGREGATES)}")
            self._bare(token, _EXPRESSION)
        self._next("")
        return self._arguments(token, _ARGUMENTS.get(name, _ANY))

    def _aggregate(self) -> _Used:
        token = self._next("")
        self._mark("(", f"after {token.text.upper()}")
        self._take_word("DISTINCT")
        if not (token.is_word("COUNT") and self._take_mark("*")):
            self._expression()
        if token.is_word("GROUP_CONCAT") and self._take_mark(";"):
            self._word("SEPARATOR", "after ;")
            self._mark("=", "after SEPARATOR")
            if (separator := self._peek()) is None or separator.kind is not Kind.STRING:
                self._unexpected("a string")
            self._next("")
        self._mark(")", f"after what {token.text.upper()} is of")
        return _Used((), True)

    def _arguments(self, function: Token, bounds: tuple[int, int]) -> _Used:
        if not self._is_mark("("):
            self._unexpected(f"( after {_short(function.text)}")
        self._next("")
        self._take_word("DISTINCT")
        used, count = _Used(), 0
        if not self._take_mark(")"):
            while True:
                argument = self._peek()
                used = _joined(used, self._expression())
                count += 1
                if function.is_word("BOUND") and argument and argument.kind is not Kind.VARIABLE:
                    self._wrong(argument, "stands where BOUND expects a variable")
                if not self._take_mark(","):
                    break
            self._mark(")", "or , or an operator")
        least, most = bounds
        if not least <= count <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            self._wrong(function, f"has {count} arguments and takes {wanted}")
        return used

    def _expression(self) -> _Used:
        used = self._operand()
        compared = False
        while True:
            token = self._peek()
            if token is None:
                return used
            is_comparison = token.is_mark(*_COMPARISONS) or token.is_word("IN", "NOT")
            if is_comparison and compared:
                self._wrong(token, "compares what a comparison says: put brackets around one of them")
            if token.is_mark("&&", "||"):
                compared = False
            compared = compared or is_comparison
            if token.is_word("IN", "NOT"):
                self._next("")
                if token.is_word("NOT"):
                    self._word("IN", "after NOT")
                used = _joined(used, self._arguments(token, _ANY))
            elif token.is_mark(*_OPERATORS):
                self._next("")
                used = _joined(used, self._operand())
            else:
                return used

    def _operand(self) -> _Used:
        while self._take_mark("!", "+", "-"):
            pass
        token = self._peek()
        if self._is_mark("("):
            return self._bracketed(_EXPRESSION)
        if token is not None and token.kind is Kind.VARIABLE:
            return _Used((self._next(""),))
        if token is not None and token.kind in (Kind.IRI, Kind.NAME):
            self._iri(_EXPRESSION)
            return self._arguments(token, _ANY) if self._is_mark("(") else _Used()
        if token is not None and token.kind is Kind.BLANK:
            self._wrong(token, "is a blank node, which cannot stand in an expression")
        if token is not None and token.kind is Kind.WORD and not token.is_word("TRUE", "FALSE"):
            return self._named(token)
        self._term(_EXPRESSION)
        return _Used()


def _joined(one: _Used, other: _Used) -> _Used:
    return _Used(one.variables + other.variables, one.aggregates or other.aggregates)


def _begins_triples(token: Token) -> bool:
    return token.kind in _TERMS or token.is_mark("[", "(", "+", "-") or token.is_word("TRUE", "FALSE")


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 3]}..."


_KEYWORDS = frozenset(
    (
        *(*_FORMS, *_MEMBERS, *_AFTER, *_AGGREGATES, *_ARGUMENTS, *_BEYOND),
        *_names(
            "WHERE PREFIX BASE FROM NAMED DISTINCT REDUCED AS BY ASC DESC UNION EXISTS NOT IN SILENT UNDEF SEPARATOR"
        ),
    )
)


def _is_known(token: Token) -> bool:
    return token.text.upper() in _KEYWORDS


def _like(text: str, known: Collection[str], mark: str = "") -> str:
    """A guess at what was meant."""
    wanted = text.upper() if known is _KEYWORDS else text
    found = get_close_matches(wanted, sorted(known), 1, 0.8) if len(text) <= _LONGEST else []
    return f" ({found[0]}{mark}?)" if found else ""
