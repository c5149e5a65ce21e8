"""Rewrite queries for a dataset that stores some literals under private datatypes (`server/store/encoding.py`).

Constants in patterns, templates and inline data become the terms that are stored. In expressions each place takes
either a term as it is stored, where it is only passed on (BIND, sameTerm, STR, a branch of IF), or a value that is
computed with. Only there a variable is decoded, in SPARQL itself: that takes half the time of a Python function. ORDER
BY, MIN and MAX compare sort keys (`server/store/sort_keys.py`). SERVICE is sent what was written.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import NamedTuple, TypeAlias

from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import rdf, xsd
from rosld.server.sparql.cursor import Cursor, Unrecognised
from rosld.server.sparql.lexer import Checked, Kind, Token, unescaped
from rosld.server.store.encoding import DOUBLE, INTEGER, NAMESPACE, NUMERIC, OTHER, PATTERN, encode_literal
from rosld.server.store.functions import GREATER, KEY, LESS, NOTHING, ORDER, PACK, TYPED, UNPACK, VALUE

_FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_OPERATORS = ("+", "-", "*", "/", "=", "!=", "<", ">", "<=", ">=", "&&", "||", "!")
_NAMES = (
    "STRLEN UCASE LCASE STRSTARTS STRENDS CONTAINS STRBEFORE STRAFTER ENCODE_FOR_URI CONCAT LANGMATCHES REGEX REPLACE "
    "MD5 SHA1 SHA256 SHA384 SHA512 LANG ISIRI ISURI ISBLANK ISLITERAL SAMETERM BOUND IRI URI BNODE STR STRLANG COUNT "
    "GROUP_CONCAT"
)
_AS_STORED = frozenset(_NAMES.split())
"""Functions that take terms as they are stored: they want text, which is never encoded, or look at no value."""
_TOTAL = frozenset(
    ("STR", "LCASE", "UCASE", "CONCAT", "REPLACE", "STRBEFORE", "STRAFTER", "SUBSTR", "LANG", "STRLEN", "COUNT", "YEAR")
)
"""Functions whose results have a total order in the dataset."""
_PASSING = frozenset(("COALESCE", "SAMPLE"))
"""Functions whose result is one of their arguments."""
_MODIFIERS = ("GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "VALUES")
_MOST_INLINE = 32
"""Variables that are decoded in SPARQL itself; more would make the text long, and are decoded by a function."""
_STRING_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_CHARACTERS = {"t": "\t", "n": "\n", "r": "\r", "b": "\b", "f": "\f"}


class _Use(Enum):
    """What an expression is for."""

    TERM = "a term as it is stored"
    VALUE = "a value to compute with"
    TEST = "whether it holds: an error is as good as false"


class _Edit(NamedTuple):
    """What takes the place of the text between two positions."""

    start: int
    end: int
    text: str


class _Variable(NamedTuple):
    start: int
    end: int
    name: str


class _Constant(NamedTuple):
    """A constant; `stored` is what stands for it in the dataset where that is another term."""

    start: int
    end: int
    kind: Kind
    stored: str | None = None


class _Expression(NamedTuple):
    """What stands between brackets or commas: operands, and the operators before and between them."""

    start: int
    end: int
    parts: tuple[_Part, ...]


class _Call(NamedTuple):
    """A call of a function: of a keyword, in capitals, or of an IRI (""), which ends at `name_end`."""

    start: int
    end: int
    name: str
    name_end: int
    arguments: tuple[_Expression, ...]


class _List(NamedTuple):
    """The list after IN."""

    start: int
    end: int
    items: tuple[_Expression, ...]


class _Exists(NamedTuple):
    """EXISTS with its group, rewritten."""

    start: int
    end: int
    text: str


_Operand: TypeAlias = "_Variable | _Constant | _Expression | _Call | _List | _Exists"
_Part: TypeAlias = "_Operand | str"


def rewrite(query: Checked, prefixes: Mapping[str, str], base: str) -> str:
    """Return the text of a query for the dataset. One that is not recognised comes back as it is."""
    if not any(_may_matter(token) for token in query.tokens):
        return query.text
    try:
        return _Rewriter(query, prefixes, base).rewritten()
    except (Unrecognised, RecursionError):
        return query.text


def rewrite_update(update: Checked, base: str) -> str:
    """Return the text of an update of the default graph. One that is not recognised comes back as it is."""
    if not any(_may_matter(token) for token in update.tokens):
        return update.text
    try:
        return _Rewriter(update, {}, base).rewritten_update()
    except (Unrecognised, RecursionError):
        return update.text


def _may_matter(token: Token) -> bool:
    """Whether a query without such tokens stays as it is."""
    if token.kind is Kind.WORD:
        return token.is_word("ORDER", "FILTER", "HAVING", "GROUP")
    return token.kind is Kind.NUMBER or token.is_mark("(", "^^")


class _Rewriter(Cursor):
    """Reads a query from its beginning to its end, and collects what is to be changed."""

    def __init__(self, query: Checked, prefixes: Mapping[str, str], base: str) -> None:
        super().__init__(query, prefixes, base)
        self._edits: list[_Edit] = []
        self._inline = 0

    def rewritten(self) -> str:
        """The query as the dataset is asked. Raises Unrecognised."""
        self.prologue()
        form = self.next()
        if form.is_word("SELECT"):
            self._projection()
        elif form.is_word("DESCRIBE"):
            while (token := self.peek()) and (token.kind in (Kind.VARIABLE, Kind.IRI, Kind.NAME) or token.is_mark("*")):
                self.skip()
        elif form.is_word("CONSTRUCT"):
            if self.is_next("{"):
                self._data()
        elif not form.is_word("ASK"):
            raise Unrecognised
        while self.take_word("FROM"):
            self.take_word("NAMED")
            self.skip()
        if self.take_word("WHERE") or self.is_next("{"):
            self._group()
        self._modifiers()
        if self.peek() is not None:
            raise Unrecognised
        return self._spliced(0, len(self.text), self._edits)

    def rewritten_update(self) -> str:
        """INSERT and DELETE, with their data, templates and patterns. Raises Unrecognised."""
        while True:
            self.prologue()
            if self.peek() is None:
                return self._spliced(0, len(self.text), self._edits)
            if not self.take_word("INSERT", "DELETE"):
                raise Unrecognised
            if self.take_word("DATA", "WHERE"):
                self._data()
            else:
                self._data()
                if self.take_word("INSERT"):
                    self._data()
                if not self.take_word("WHERE"):
                    raise Unrecognised
                self._group()
            if not self.take(";") and self.peek() is not None:
                raise Unrecognised

    def _spliced(self, start: int, end: int, edits: Sequence[_Edit]) -> str:
        """The text between two positions, with edits that do not overlap, in their order."""
        pieces: list[str] = []
        for edit in edits:
            pieces += (self.text[start : edit.start], edit.text)
            start = edit.end
        return "".join((*pieces, self.text[start:end]))

    def _projection(self) -> None:
        self.take_word("DISTINCT", "REDUCED")
        while (token := self.peek()) is not None:
            if token.is_mark("("):
                self._bracketed(_Use.TERM)
            elif token.kind is Kind.VARIABLE or token.is_mark("*"):
                self.skip()
            else:
                return

    def _bracketed(self, use: _Use) -> None:
        """An expression in brackets, which may be given a name there (AS)."""
        self.expect("(")
        self._edit(self._expression(), use)
        if self.take_word("AS"):
            self.skip()
        self.expect(")")

    def _edit(self, operand: _Operand, use: _Use) -> None:
        self._edits.append(_Edit(operand.start, operand.end, self._written(operand, use)))

    # --- solution modifiers

    def _modifiers(self) -> None:
        while (token := self.peek()) is not None and not token.is_mark("}"):
            if self.take_word("GROUP"):
                self._by()
                while self._is_condition():
                    self._condition(_Use.TERM)
            elif self.take_word("HAVING"):
                while self._is_condition():
                    self._condition(_Use.TEST)
            elif self.take_word("ORDER"):
                self._by()
                while self._is_condition():
                    self._order()
            elif self.take_word("LIMIT", "OFFSET"):
                self.skip()
            elif self.take_word("VALUES"):
                self._values()
            else:
                raise Unrecognised

    def _by(self) -> None:
        if not self.take_word("BY"):
            raise Unrecognised

    def _is_condition(self) -> bool:
        token = self.peek()
        if token is None or token.is_word(*_MODIFIERS):
            return False
        return token.kind in (Kind.VARIABLE, Kind.WORD, Kind.IRI, Kind.NAME) or token.is_mark("(")

    def _condition(self, use: _Use) -> None:
        """A variable, a call, EXISTS, or an expression in brackets."""
        if self.is_next("("):
            self._bracketed(use)
        else:
            self._edit(self._operand(), use)

    def _order(self) -> None:
        """A condition of ORDER BY: what is compared has a total order."""
        direction = self.next().text if self.is_word("ASC", "DESC") else "ASC"
        begin = self.peek(-1)
        operand = self._operand()
        core = _core(operand)
        if isinstance(core, _Variable):
            conditions = [each.replace("?", core.name) for each in _ORDERED]
        elif isinstance(core, _Call) and core.name in _TOTAL:
            conditions = [self._written(operand, _Use.TERM)]
        else:
            conditions = [f"<{KEY}>({self._written(operand, _Use.TERM)})"]
        start = begin.start if begin is not None and begin.is_word("ASC", "DESC") else operand.start
        written = "".join(f" {direction}({each})" for each in conditions)
        self._edits.append(_Edit(start, operand.end, f"{written} "))

    # --- groups

    def _group(self) -> None:
        self.expect("{")
        if self.take_word("SELECT"):
            self._projection()
            self.take_word("WHERE")
            self._group()
            self._modifiers()
        else:
            while not self.is_next("}"):
                self._member()
        self.expect("}")

    def _member(self) -> None:
        if self.is_next("{"):
            self._group()
        elif self.take_word("FILTER"):
            self._condition(_Use.TEST)
        elif self.take_word("BIND"):
            self._bracketed(_Use.TERM)
        elif self.take_word("VALUES"):
            self._values()
        elif self.take_word("SERVICE"):
            self.take_word("SILENT")
            self.skip()
            self.skip_group()  # another endpoint's
        elif not self.take_word("OPTIONAL", "MINUS", "UNION", "GRAPH"):
            self._node()

    def _values(self) -> None:
        while (token := self.peek()) and (token.kind is Kind.VARIABLE or token.is_mark("(", ")")):
            self.skip()
        self._data()

    def _data(self) -> None:
        """Nodes up to the closing brace: of a template, or of inline data."""
        self.expect("{")
        while not self.take("}"):
            if self.is_next("{"):
                raise Unrecognised
            self._node()

    def _node(self) -> None:
        """A literal, or a token that is none of it."""
        constant = self._literal()
        if constant is None:
            self.next()
        elif constant.stored is not None:
            self._edit(constant, _Use.TERM)

    def _literal(self) -> _Constant | None:
        """Take a literal if one is next."""
        token = self.peek()
        if token is None:
            return None
        if token.kind is Kind.STRING:
            self.skip()
            return self._string(token)
        if token.kind is Kind.NUMBER:
            self.skip()
            return _number(token.start, token.text)
        number = self.peek(1)
        if token.is_mark("+", "-") and number and number.kind is Kind.NUMBER and number.start == token.end:
            self.skip()
            self.skip()
            return _number(token.start, token.text + number.text)
        return None

    def _string(self, token: Token) -> _Constant:
        following = self.peek()
        if following is not None and following.kind is Kind.LANGUAGE:
            self.skip()
            return _Constant(token.start, following.end, Kind.STRING)
        if not self.take("^^"):
            return _Constant(token.start, token.end, Kind.STRING)
        name = self.next()
        stored = _stored(_lexical(token.text), self.iri(name))
        return _Constant(token.start, name.end, Kind.NUMBER, stored)

    # --- reading expressions

    def _expression(self) -> _Expression:
        parts: list[_Part] = []
        begin = self.peek()
        while (token := self.peek()) is not None and not token.is_mark(")", ",", ";") and not token.is_word("AS"):
            if parts and not isinstance(parts[-1], str):
                operator = self._operator()
                parts += (operator, self._list()) if operator in ("IN", "NOT IN") else (operator,)
            elif token.is_mark("!") or (token.is_mark("+", "-") and not self._is_number()):
                parts.append(self._operator())
            else:
                parts.append(self._operand())
        if begin is None or not parts or isinstance(parts[-1], str):
            raise Unrecognised
        return _Expression(begin.start, parts[-1].end, tuple(parts))

    def _is_number(self) -> bool:
        sign, number = self.peek(), self.peek(1)
        return sign is not None and number is not None and number.kind is Kind.NUMBER and number.start == sign.end

    def _operator(self) -> str:
        token = self.next()
        if token.is_word("IN"):
            return "IN"
        if token.is_word("NOT") and self.take_word("IN"):
            return "NOT IN"
        if not token.is_mark(*_OPERATORS):
            raise Unrecognised
        return token.text

    def _list(self) -> _List:
        token = self.peek()
        self.expect("(")
        assert token is not None
        items = self._arguments()
        return _List(token.start, self._end(), items)

    def _operand(self) -> _Operand:
        constant = self._literal()
        if constant is not None:
            return constant
        token = self.next()
        if token.kind is Kind.VARIABLE:
            return _Variable(token.start, token.end, token.text)
        if token.is_mark("("):
            inner = self._expression()
            self.expect(")")
            return _Expression(token.start, self._end(), (inner,))
        if token.is_word("EXISTS") or (token.is_word("NOT") and self.take_word("EXISTS")):
            return self._exists(token)
        if token.kind not in (Kind.WORD, Kind.IRI, Kind.NAME):
            raise Unrecognised
        if self.take("("):
            arguments = self._arguments()
            name = token.text.upper() if token.kind is Kind.WORD else ""
            return _Call(token.start, self._end(), name, token.end, arguments)
        return _Constant(token.start, token.end, token.kind)

    def _exists(self, token: Token) -> _Exists:
        outer, self._edits = self._edits, []
        self._group()
        end = self._end()
        text = self._spliced(token.start, end, self._edits)
        self._edits = outer
        return _Exists(token.start, end, text)

    def _arguments(self) -> tuple[_Expression, ...]:
        """What stands between brackets of which the first is taken."""
        found: list[_Expression] = []
        self.take_word("DISTINCT")
        if self.take("*"):  # COUNT(*)
            self.expect(")")
            return ()
        while not self.take(")"):
            found.append(self._expression())
            if self.take(";"):  # SEPARATOR = "..."
                self.skip()
                self.expect("=")
                self.skip()
            elif not self.take(",") and not self.is_next(")"):
                raise Unrecognised
        return tuple(found)

    def _end(self) -> int:
        """Where the token ends that was taken last."""
        token = self.peek(-1)
        assert token is not None
        return token.end

    # --- writing expressions

    def _written(self, operand: _Operand, use: _Use) -> str:
        match operand:
            case _Variable(name=name):
                return name if use is _Use.TERM else self._decoded(name)
            case _Constant(start, end, _, stored):
                return self.text[start:end] if stored is None or use is not _Use.TERM else stored
            case _Exists(text=text):
                return text
            case _List(start, end, items):
                return self._with(start, end, [(item, _Use.VALUE) for item in items])
            case _Expression(start, end, parts):
                return self._with(start, end, _uses(parts, use))
            case _Call():
                return self._call(operand, use)

    def _with(self, start: int, end: int, uses: Iterable[tuple[_Operand, _Use]]) -> str:
        edits = [_Edit(each.start, each.end, self._written(each, use)) for each, use in uses]
        return self._spliced(start, end, edits)

    def _decoded(self, variable: str) -> str:
        """A variable as a value to compute with."""
        self._inline += 1
        if self._inline > _MOST_INLINE:
            return f"<{VALUE}>({variable})"
        return _DECODED.replace("?", variable)

    def _call(self, call: _Call, use: _Use) -> str:
        name, passed = call.name, _Use.TERM if use is _Use.TERM else _Use.VALUE
        number = len(call.arguments)
        if name in _AS_STORED:
            uses = [_Use.TERM] * number
        elif name in _PASSING:
            uses = [passed] * number
        elif name == "IF":
            uses = [_Use.VALUE, passed, passed][:number]
        elif name == "SUBSTR":
            uses = [_Use.TERM, _Use.VALUE, _Use.VALUE][:number]
        elif name == "DATATYPE":
            return f'IRI(REPLACE(STR({self._arguments_of(call, [_Use.TERM])}),"^{PATTERN}","{xsd.iri}"))'
        elif name in ("MIN", "MAX") and number == 1 and _passes(call.arguments[0]):
            found = self._extreme(call)
            return found if use is _Use.TERM else f"<{VALUE}>({found})"
        elif name == "STRDT" and use is _Use.TERM:
            return f"<{TYPED}>{self._arguments_of(call, [_Use.TERM] * number)[len(name) :]}"
        else:
            uses = [_Use.VALUE] * number
        return self._arguments_of(call, uses)

    def _extreme(self, call: _Call) -> str:
        """MIN or MAX, whose result is one of the terms: the dataset compares numbers, and keys of other terms."""
        [argument] = call.arguments
        core = _core(argument)

        def over(written: str) -> str:
            return self._spliced(call.start, call.end, [_Edit(argument.start, argument.end, written)])

        if not isinstance(core, _Variable):
            return f"<{UNPACK}>({over(f'<{PACK}>({self._written(argument, _Use.TERM)})')})"
        name, function = core.name, GREATER if call.name == "MAX" else LESS
        no_number, no_key = (f"<{NAMESPACE}>", '""') if call.name == "MAX" else (f'"{NOTHING}"',) * 2
        numbers = over(f"IF(isNumeric({name}),{name},{no_number})")
        keys = over(f"IF(isNumeric({name}),{no_key},<{PACK}>({name}))")
        return f"<{function}>({numbers},{keys})"

    def _arguments_of(self, call: _Call, uses: Sequence[_Use]) -> str:
        """The call with its arguments written for these uses."""
        if len(uses) != len(call.arguments):
            raise Unrecognised
        return self._with(call.start, call.end, zip(call.arguments, uses, strict=True))


_DECODED = (
    f'IF(isNumeric(?),?,COALESCE(IF(STRSTARTS(STR(DATATYPE(?)),"{INTEGER}"),STRDT(STR(?),<{xsd.integer.value}>),'
    f'IF(STRSTARTS(STR(DATATYPE(?)),"{DOUBLE}"),STRDT(STR(?),<{xsd.double.value}>),'
    f'IF(STRSTARTS(STR(DATATYPE(?)),"{NAMESPACE}"),'
    f'STRDT(STR(?),IRI(CONCAT("{xsd.iri}",SUBSTR(STR(DATATYPE(?)),{len(OTHER) + 1})))),?))),?))'
)
"""The value of the variable `?`."""


_TEXTUAL = f"DATATYPE(?) IN(<{xsd.string.value}>,<{rdf.langString.value}>)"
_IS_NUMERIC = f'STRSTARTS(STR(DATATYPE(?)),"{NUMERIC}")'
_MOMENT = xsd.dateTime.value
_ORDERED = (
    f"IF(isNumeric(?),2,IF(!isLiteral(?),IF(isIRI(?),1,0),IF({_TEXTUAL},3,IF({_IS_NUMERIC},2,"
    f"IF(DATATYPE(?)=<{OTHER}dateTime>||DATATYPE(?)=<{_MOMENT}>&&COALESCE(isNumeric(YEAR(?)),false),4,5)))))",
    f"IF(isNumeric(?),<{xsd.double.value}>(?),IF(!isLiteral(?),?,IF({_TEXTUAL},STR(?),"
    f"IF({_IS_NUMERIC},<{xsd.double.value}>(STR(?)),"
    f'IF(DATATYPE(?)=<{_MOMENT}>&&COALESCE(TZ(?)!="",false),?,<{ORDER}>(?))))))',
    f"IF(isNumeric(?)||{_IS_NUMERIC},IF(STRLEN(STR(?))>15&&DATATYPE(?)!=<{xsd.double.value}>"
    f'&&DATATYPE(?)!=<{DOUBLE}double>,<{KEY}>(?),""),LANG(?))',
)
"""What the variable `?` is ordered by: its kind, its value, and what tells values apart that are one double."""


def _core(operand: _Operand) -> _Operand:
    """What stands within brackets that hold nothing else."""
    if isinstance(operand, _Expression) and len(operand.parts) == 1 and not isinstance(operand.parts[0], str):
        return _core(operand.parts[0])
    return operand


def _passes(operand: _Operand) -> bool:
    """Whether its result may be a term that is stored, and not only one that is computed."""
    core = _core(operand)
    if isinstance(core, _Call):
        return core.name in _PASSING or core.name in ("IF", "MIN", "MAX", "STRDT")
    return isinstance(core, _Variable | _Constant)


def _uses(parts: Sequence[_Part], use: _Use) -> Iterator[tuple[_Operand, _Use]]:
    """The operands of an expression, and what each is for."""
    if len(parts) == 1:
        [operand] = parts
        assert not isinstance(operand, str)
        yield operand, use
        return
    for comparison in _comparisons(parts):
        operands = [part for part in comparison if not isinstance(part, str)]
        if len(comparison) == 1:
            yield operands[0], _Use.TEST if use is _Use.TEST else _Use.VALUE
            continue
        plain = _is_plain(comparison, use)
        for operand in operands:
            yield operand, _Use.TERM if plain and isinstance(operand, _Variable) else _Use.VALUE


def _comparisons(parts: Sequence[_Part]) -> Iterator[Sequence[_Part]]:
    """What stands between the operators && and ||."""
    begin = 0
    for at, part in enumerate(parts):
        if part in ("&&", "||"):
            yield parts[begin:at]
            begin = at + 1
    yield parts[begin:]


def _is_plain(comparison: Sequence[_Part], use: _Use) -> bool:
    """Whether it comes to the same for a number or a time and for the private literal that stands for it.

    An IRI equals neither, and compares with neither. Text equals neither; with the private literal it is an error.
    """
    if len(comparison) != 3:
        return False
    first, operator, second = comparison
    items = (
        [item.parts[0] if len(item.parts) == 1 else item for item in second.items] if isinstance(second, _List) else []
    )
    kinds = {each.kind for each in (first, second, *items) if isinstance(each, _Constant)}
    others = [each for each in items if not isinstance(each, _Constant)]
    if not kinds or others:
        return False
    if kinds <= {Kind.IRI, Kind.NAME}:
        return True
    return use is _Use.TEST and operator not in ("!=", "NOT IN") and kinds <= {Kind.IRI, Kind.NAME, Kind.STRING}


def _number(start: int, text: str) -> _Constant:
    name = "double" if "e" in text.lower() else "decimal" if "." in text else "integer"
    return _Constant(start, start + len(text), Kind.NUMBER, _stored(text, xsd.iri + name))


def _stored(lexical: str, datatype: str) -> str | None:
    """What a literal is stored as, None where it is stored as it is."""
    literal = Literal(lexical, datatype=NamedNode(datatype))
    stored = encode_literal(literal)
    return None if stored is literal else str(stored)


def _lexical(text: str) -> str:
    """What stands between the quotes, without escapes."""
    length = 3 if text[:3] in ('"""', "'''") and len(text) >= 6 else 1
    return _STRING_ESCAPE.sub(lambda match: _CHARACTERS.get(match[1], match[1]), unescaped(text[length:-length]))
