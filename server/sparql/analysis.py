"""Analysing a query before it is asked: is it fit to be parsed, of what form is it, what does it need. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

from rosld.ontology.vocab import PREFIXES
from rosld.server.http.problem import Problem
from rosld.server.sparql.cursor import Unrecognised
from rosld.server.sparql.functions import AGE
from rosld.server.sparql.grammar import ELSEWHERE, read
from rosld.server.sparql.lexer import BOUNDS, NOWHERE, Bounds, Checked, Kind, Reach, Token, check, place, update_keyword
from rosld.server.sparql.modest import is_modest
from rosld.server.sparql.narrowing import needs
from rosld.server.sparql.needs import EVERYTHING, Needs
from rosld.server.sparql.patterns import graphs_around
from rosld.server.sparql.small import Plan, plan
from rosld.server.sparql.terms import Terms

_CHANGING = frozenset({"NOW", "RAND", "UUID", "STRUUID", "BNODE", AGE, ELSEWHERE})
_FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
_MOST_UNREAD = 60
_SHORT = 512
"""Characters of a CONSTRUCT whose template makes few triples of each solution."""
_KEPT = 512


@dataclass(frozen=True, slots=True)
class Analysis:
    """A query fit to be asked: `text` is what goes to the store.

    `form` is SELECT, ASK, CONSTRUCT or DESCRIBE, None where only the store can tell. `needs` are over all graphs, its
    FROM and FROM NAMED being `default_graphs` and `named_graphs`. `lasting`: the answer is the same for as long as the
    dataset is. `modest`: its form keeps it small where no resource has many values. `prefixes`: those of the server
    that its names use. `enclosed` are the graphs that all its patterns stand in (GRAPH), None where one may match in
    others. `plan` is how to find out whether it is small over a dataset, None where it may be anything. `streams`:
    every statement that is looked at is told. `plain`: it is nothing but patterns, each in one graph. `filters`: the
    store may scan what a constraint leaves nothing of. `elsewhere`: it asks other endpoints (SERVICE).
    """

    text: str
    form: str | None
    needs: Needs
    lasting: bool
    modest: bool
    prefixes: Mapping[str, str]
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    enclosed: frozenset[str] | None = None
    plan: Plan | None = None
    streams: bool = False
    plain: bool = False
    filters: bool = True
    elsewhere: bool = False


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
        relations: Callable[[], frozenset[str]] = frozenset,
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
        except (Unrecognised, RecursionError):
            return self._unread(checked)
        lasting = not reading.functions & _CHANGING
        terms = Terms(self._types, self._known)
        words = [token.text.upper() for token in checked.tokens if token.kind is Kind.WORD]
        steps = sum(token.kind in (Kind.WORD, Kind.MARK) for token in checked.tokens)
        found = None
        if reading.form != "DESCRIBE" and (reading.form != "CONSTRUCT" or len(text) <= _SHORT):
            found = plan(reading.where, words, steps, len(reading.default) + len(reading.named))
        single = found is not None and len(found) == len(found[0]) == 1
        return Analysis(
            checked.text,
            reading.form,
            needs(reading, terms),
            lasting,
            is_modest(reading.where, words, terms),
            self._used_prefixes(checked),
            reading.default,
            reading.named,
            graphs_around(reading.where),
            found,
            single and reading.plain and "OFFSET" not in words,
            reading.plain,
            any("FILTER" in word or "HAVING" in word for word in words),
            ELSEWHERE in words,
        )

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
        elsewhere = any(token.is_word(ELSEWHERE) for token in checked.tokens)
        return Analysis(checked.text, form, EVERYTHING, False, False, self.prefixes, elsewhere=elsewhere)


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
