"""Analysis of a query before it is evaluated: whether it may be parsed, its form, its needs. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from rosld.ontology.vocab import PREFIXES, hctl, htv, td
from rosld.server.dataset import QueryError
from rosld.server.dataset.encoding import NAMESPACE
from rosld.server.http.problem import Problem
from rosld.server.sparql.needs import Needs, needs_of
from rosld.server.sparql.past import MessageTerms, PastQuery, past_query
from rosld.server.sparql.rewriting import rewrite
from rosld.server.sparql.ros_functions import AGE
from rosld.server.sparql.syntax.lexer import (
    NO_SERVICES,
    CheckedText,
    ServiceAllowlist,
    check_text,
    update_keyword,
)
from rosld.server.sparql.syntax.query import parse_query
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.syntax.tree import TYPE, Group, Iri, Pattern, Query, Variable, graphs_around

_KEPT = 512
_OFFERS = (td.iri, hctl.iri, htv.iri)
"""The vocabularies of affordances and forms."""


@dataclass(frozen=True, slots=True)
class Analysis:
    """A query that may be evaluated: `text` is what goes to the store.

    `form` is SELECT, ASK, CONSTRUCT or DESCRIBE. `needs` are over all graphs, its FROM and FROM NAMED being
    `default_graphs` and `named_graphs`. `prefixes`: those of the server that its names use. `is_enclosed` are the
    graphs that all its patterns stand in (GRAPH), None where one may match in others. `asks_age`: it calls ros:age, as
    far as is known. `functions` are those that it calls by IRI. `past` is what it asks of recorded messages.
    `finds_offers`: its patterns may match affordances and forms.
    """

    text: str
    form: str
    needs: Needs
    prefixes: Mapping[str, str]
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    is_enclosed: frozenset[str] | None = None
    asks_age: bool = True
    functions: frozenset[str] = frozenset()
    past: PastQuery | None = None
    finds_offers: bool = True


class Analyser:
    """Analyses queries for one server: `base` resolves their relative IRIs, `types` is the namespace of message types.

    `prefixes` hold where a query does not declare them itself; `reach` is where SERVICE may lead.
    """

    def __init__(
        self,
        base: str,
        types: str,
        *,
        prefixes: Mapping[str, str] = PREFIXES,
        reach: ServiceAllowlist = NO_SERVICES,
    ) -> None:
        self.base = base
        self.prefixes = dict(prefixes)
        self._types = types
        self._reach = reach
        self.analyse = lru_cache(maxsize=_KEPT)(self.analyse_once)
        """Analyse a query as `analyse_once` does, remembering the last ones."""

    def analyse_once(self, text: str) -> Analysis:
        """The analysis of a query, in any thread.

        Raises Problems: those of `check_text` and `parse_query`, and 400 for an update.
        """
        checked = check_text(text, reach=self._reach)
        if keyword := update_keyword(checked.tokens):
            raise Problem(400, f"{keyword} is an update, and this is the endpoint for queries: it only reads.")
        query = parse_query(checked, self.prefixes, self.base, AGE)
        past = past_query(query, MessageTerms(self._types, self.base))
        return Analysis(
            rewrite(checked.text, query.literals, query.expressions),
            query.form,
            needs_of(query, self.base),
            self._used_prefixes(checked),
            query.default,
            query.named,
            _enclose(query),
            AGE in query.functions,
            query.functions,
            past,
            query.form == "DESCRIBE" or _finds_offers(query.where),
        )

    def _used_prefixes(self, checked: CheckedText) -> Mapping[str, str]:
        """Only what a query uses: the store's parser copies all that it is given."""
        names = {token.text.partition(":")[0] for token in checked.tokens if token.kind is Kind.NAME}
        return {name: self.prefixes[name] for name in names & self.prefixes.keys()}


def _enclose(query: Query) -> frozenset[str] | None:
    """The graphs that it can look at, where all that it looks at stands in GRAPH; None where it may be any."""
    if query.form == "DESCRIBE" or _names_any(query.where):
        return None
    return graphs_around(query.where) or None


def _names_any(group: Group) -> bool:
    """Whether there is a GRAPH with a variable, which may stand for any graph even with no pattern in it."""
    inner = (*group.children, *group.filters)
    return isinstance(group.graph, Variable) or any(map(_names_any, inner))


def _finds_offers(group: Group) -> bool:
    """Whether a pattern may match what says of a resource that something may be done with it."""
    return any(map(_is_of_offers, group.patterns)) or any(map(_finds_offers, (*group.children, *group.filters)))


def _is_of_offers(pattern: Pattern) -> bool:
    if pattern.predicates is None or any(each.startswith(_OFFERS) for each in pattern.predicates):
        return True
    is_typed = isinstance(pattern.object, Iri) and not pattern.object.value.startswith(_OFFERS)
    return TYPE in pattern.predicates and (pattern.repeated or not is_typed)


def parse_problem(error: QueryError, text: str) -> Problem:
    """Why the store does not take a query that was read without an error; `text` is what it was given.

    Its parser's list of what it would have gone on with says nothing to people.
    """
    where = _PLACE.match(str(error))
    if where is None:
        return Problem(400, f"The query is refused: {error}.")
    is_as_written = NAMESPACE not in text
    return Problem(400, f"The query is not understood{f' at {where[1]}' if is_as_written else ''}.")


_PLACE = re.compile(r"error at (\d+:\d+): ")
