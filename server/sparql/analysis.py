"""Analysing a query before it is asked: is it fit to be parsed, of what form is it, what does it need. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

from rosld.ontology.vocab import PREFIXES
from rosld.server.http.problem import Problem
from rosld.server.sparql.cursor import Unrecognised
from rosld.server.sparql.functions import AGE
from rosld.server.sparql.grammar import read
from rosld.server.sparql.lexer import BOUNDS, NOWHERE, Bounds, Checked, Kind, Reach, Token, check, place, update_keyword
from rosld.server.sparql.narrowing import needs
from rosld.server.sparql.needs import EVERYTHING, Needs
from rosld.server.sparql.patterns import Group, Reading, Variable, graphs_around
from rosld.server.sparql.process.cost import Plan, plan
from rosld.server.sparql.rewriting import rewrite
from rosld.server.sparql.syntax import refusal, syntax_error
from rosld.server.sparql.terms import Terms
from rosld.server.store import QueryError
from rosld.server.store.encoding import NAMESPACE

_FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_MOST_UNREAD = 60
_KEPT = 512
_NO_RELATIONS = frozenset[str]()


@dataclass(frozen=True, slots=True)
class Analysis:
    """A query fit to be asked: `text` is what goes to the store.

    `form` is SELECT, ASK, CONSTRUCT or DESCRIBE, None where only the store can tell. `needs` are over all graphs, its
    FROM and FROM NAMED being `default_graphs` and `named_graphs`. `prefixes`: those of the server that its names use.
    `enclosed` are the graphs that all its patterns stand in (GRAPH), None where one may match in others. `plan` is how
    to find out whether it takes long over a dataset, None where it may. `asks_age`: it calls ros:age, as far as is
    known. `functions` are those that it calls by IRI.
    """

    text: str
    form: str | None
    needs: Needs
    prefixes: Mapping[str, str]
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    enclosed: frozenset[str] | None = None
    plan: Plan | None = None
    asks_age: bool = True
    functions: frozenset[str] = frozenset()


class Analyser:
    """Analyses queries for one server: `base` resolves their relative IRIs, `types` is the namespace of message types.

    `prefixes` hold where a query does not declare them itself; `reach` is where SERVICE may lead. `relations` tells the
    predicates that mappings give complex resources: the same object for as long as they are the same.
    """

    def __init__(
        self,
        base: str,
        types: str,
        *,
        prefixes: Mapping[str, str] = PREFIXES,
        bounds: Bounds = BOUNDS,
        reach: Reach = NOWHERE,
        relations: Callable[[], frozenset[str]] = lambda: _NO_RELATIONS,
    ) -> None:
        self.base = base
        self.prefixes = dict(prefixes)
        self._types = types
        self._bounds = bounds
        self._reach = reach
        self._relations = relations
        self._known = relations()
        self._kept = lru_cache(maxsize=_KEPT)(self.analyse_once)

    def analyse(self, text: str) -> Analysis:
        """The analysis of a query, kept for when it is asked again. Raises as `analyse_once` does."""
        relations = self._relations()
        if relations is not self._known:
            self._known = relations
            self._kept.cache_clear()
        return self._kept(text)

    def analyse_once(self, text: str) -> Analysis:
        """The analysis of a query, in any thread.

        Raises Problems: those of `check`, and 400 for an update.
        """
        checked = check(text, self._bounds, reach=self._reach)
        if keyword := update_keyword(checked.tokens):
            raise Problem(400, f"{keyword} is an update, and this is the endpoint for queries: it only reads.")
        try:
            reading = read(checked, self.prefixes, self.base, AGE, self._bounds)
        except (Unrecognised, RecursionError) as error:
            if wrong := syntax_error(text, self.prefixes):
                raise Problem(400, wrong) from error
            return self._unread(checked)
        terms = Terms(self._types, self.base, self._known)
        words = [token.text.upper() for token in checked.tokens if token.kind is Kind.WORD]
        return Analysis(
            rewrite(checked, self.prefixes, self.base),
            reading.form,
            needs(reading, terms),
            self._used_prefixes(checked),
            reading.default,
            reading.named,
            _enclosed(reading),
            plan(reading.where, words, len(checked.tokens)),
            AGE in reading.functions,
            frozenset(name for name in reading.functions if ":" in name),
        )

    def refusal(self, text: str, error: QueryError) -> Problem:
        """Why the store does not take a query that was analysed, in words for people."""
        if NAMESPACE in self.analyse(text).text:  # it was rewritten, and the parser tells another place
            return Problem(400, syntax_error(text, self.prefixes) or "The query is not understood.")
        return refusal(error, text, self.prefixes)

    def _used_prefixes(self, checked: Checked) -> Mapping[str, str]:
        """Only what a query uses: the store's parser copies all that it is given."""
        names = {token.text.partition(":")[0] for token in checked.tokens if token.kind is Kind.NAME}
        return {name: self.prefixes[name] for name in names & self.prefixes.keys()}

    def _unread(self, checked: Checked) -> Analysis:
        """What is not understood here goes to the store's parser for its words, if it is short enough to be safe."""
        _check_comparisons(checked)
        terms = [token for token in checked.tokens if token.kind not in (Kind.MARK, Kind.WORD)]
        if len(terms) > _MOST_UNREAD:
            raise Problem(400, "The query is no SPARQL 1.1, or begins to be none, somewhere: cut it to find the place.")
        form = next((token.text.upper() for token in checked.tokens if token.is_word(*_FORMS)), None)
        text = rewrite(checked, self.prefixes, self.base)
        return Analysis(text, form, EVERYTHING, self.prefixes)


def _enclosed(reading: Reading) -> frozenset[str] | None:
    """The graphs that it can look at, where all that it looks at stands in GRAPH; None where it may be any."""
    if reading.form == "DESCRIBE" or _names_any(reading.where):
        return None
    return graphs_around(reading.where) or None


def _names_any(group: Group) -> bool:
    """Whether there is a GRAPH with a variable, which may stand for any graph even with no pattern in it."""
    inner = (*group.children, *group.filters)
    return isinstance(group.graph, Variable) or any(map(_names_any, inner))


def _check_comparisons(checked: Checked) -> None:
    """Refuse what may be an IRI, or "less than" and a comment: a comment must not hide anything."""
    before: Token | None = None
    brackets: list[str] = []
    for token in checked.tokens:
        if token.is_mark("(", "[", "{"):
            brackets.append(token.text)
        elif token.is_mark(")", "]", "}") and brackets:
            brackets.pop()
        elif (
            token.kind is Kind.IRI and "#" in token.text and brackets[-1:] == ["("] and before and _ends_operand(before)
        ):
            where = place(checked.text, token.start)
            raise Problem(400, f"The query is not understood; is {token.text} at {where} an IRI or a comparison?")
        before = token


def _ends_operand(token: Token) -> bool:
    if token.kind is Kind.WORD:
        return token.text.upper().endswith(("TRUE", "FALSE"))
    return token.is_mark(")", "}") or token.kind not in (Kind.MARK, Kind.WORD)
