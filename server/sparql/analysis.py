"""Static analysis of a query before its evaluation: whether it is allowed, its form and its needs. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from urllib.parse import unquote

from msgspec import Struct

from rosld.ontology.units import has_no_own_unit, quantity_of
from rosld.ontology.vocab import PREFIXES, hctl, htv, ros, td
from rosld.server.dataset import QueryError
from rosld.server.dataset.encoding import NAMESPACE
from rosld.server.http.problem import Problem
from rosld.server.sparql.needs import Needs, groups_within, needs_of
from rosld.server.sparql.past import MessageTerms, PastQuery, past_query
from rosld.server.sparql.rewriting import rewrite
from rosld.server.sparql.ros_functions import AGE, OWN
from rosld.server.sparql.summaries import SummaryQuery, summary_query
from rosld.server.sparql.syntax.cursor import did_you_mean
from rosld.server.sparql.syntax.lexer import (
    NO_SERVICES,
    CheckedText,
    ServiceAllowlist,
    check_text,
    update_keyword,
)
from rosld.server.sparql.syntax.query import parse_query
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.syntax.tree import TYPE, Group, Iri, Pattern, Query, Term, Variable, graphs_around

_CACHE_SIZE = 512
_OFFERS = (td.iri, hctl.iri, htv.iri)
"""Namespaces of affordances and forms."""


class Analysis(Struct, frozen=True):
    """An accepted query; `text` is what is sent to the store.

    `form` is SELECT, ASK, CONSTRUCT or DESCRIBE. `needs` cover all graphs; FROM and FROM NAMED are in `default_graphs`
    and `named_graphs`. `prefixes` are the server's prefixes that the query uses. `is_enclosed` holds the graphs named
    by GRAPH if every pattern is inside one, else None. `asks_age`: the query calls ros:age, or may do so. `functions`
    are the functions it calls by IRI. `past` describes the recorded messages it reads. `finds_offers`: its patterns may
    match affordances and forms. `summary` has the same results, if it can be answered from statistics.
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
    summary: Summary | None = None


class Summary(Struct, frozen=True):
    """A query over summaries of messages, and its analysis."""

    query: SummaryQuery
    analysis: Analysis


class Analyser:
    """Query analyser of one server: `base` resolves relative IRIs, `types` is the namespace of message types.

    `prefixes` apply where a query does not declare them; `reach` lists the endpoints that SERVICE may call.
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
        self.analyse = lru_cache(maxsize=_CACHE_SIZE)(self.analyse_once)
        """Cached `analyse_once`."""

    def analyse_once(self, text: str, *, is_over_summaries: bool = False) -> Analysis:
        """Return the analysis of a query (thread-safe), possibly over summaries of messages.

        Raises the Problems of `check_text` and `parse_query`, and Problem 400 for an update.
        """
        checked = check_text(text, reach=self._reach)
        if keyword := update_keyword(checked.tokens):
            raise Problem(400, f"{keyword} is an update, but this is the query endpoint, which only reads.")
        query = parse_query(checked, self.prefixes, self.base, AGE)
        _require_own_functions(query.functions)
        units = _units_of_variables(query.where, self._types) if ros.convert.value in query.functions else {}
        past = past_query(query, MessageTerms(self._types, self.base))
        summary = None if past is None or is_over_summaries else summary_query(query, past, self._types)
        replaced = () if past is None or is_over_summaries else past.replaced
        return Analysis(
            rewrite(checked.text, query.literals, query.expressions, units, replaced),
            query.form,
            needs_of(query, self.base, () if past is None else past.recorded_patterns()),
            self._used_prefixes(checked),
            query.default,
            query.named,
            _enclose(query),
            AGE in query.functions,
            query.functions,
            past,
            query.form == "DESCRIBE" or _finds_offers(query.where),
            None if summary is None else self._over_summaries(summary),
        )

    def _over_summaries(self, summary: SummaryQuery) -> Summary | None:
        """Return the query over summaries with its analysis, None where its text exceeds the bounds of a query."""
        try:
            return Summary(summary, self.analyse_once(summary.text, is_over_summaries=True))
        except Problem:
            return None

    def _used_prefixes(self, checked: CheckedText) -> Mapping[str, str]:
        """Return only the prefixes that a query uses, because the store's parser copies every prefix passed to it."""
        names = {token.text.partition(":")[0] for token in checked.tokens if token.kind is Kind.NAME}
        return {name: self.prefixes[name] for name in names & self.prefixes.keys()}


def _units_of_variables(where: Group, types: str) -> dict[str, str]:
    """Return the units of the variables that are bound to fields of messages, where all patterns agree.

    A field without a unit of its own, such as a coordinate of a vector, has that of the field that binds its subject.
    Fields around it that have none cancel that (`quantity_within`).
    """
    fields: dict[Term, list[tuple[Term, str, str]]] = {}
    for group in groups_within(where):
        for pattern in group.patterns:
            for predicate in pattern.predicates or ():
                type_name, _, field = unquote(predicate.removeprefix(types)).partition("#")
                if predicate.startswith(types):
                    fields.setdefault(pattern.object, []).append((pattern.subject, type_name, field))

    def units(node: Term, depth: int = 8) -> set[str | None]:
        found = set[str | None]()
        for subject, type_name, field in fields.get(node, ()) if depth else ():
            quantity = quantity_of(type_name, field)
            found |= units(subject, depth - 1) if quantity is None else {quantity.unit}
            found |= {None} if is_cancelled(subject, depth - 1) else set()
        return found or {None}

    def is_cancelled(node: Term, depth: int) -> bool:
        around = fields.get(node, ()) if depth else ()
        return any(has_no_own_unit(*names) or is_cancelled(subject, depth - 1) for subject, *names in around)

    all_units = ((node.name, units(node)) for node in fields if isinstance(node, Variable))
    return {name: unit for name, found in all_units if len(found) == 1 and (unit := found.pop()) is not None}


def _enclose(query: Query) -> frozenset[str] | None:
    """Return the graphs a query can read if all its patterns are inside GRAPH, else None."""
    if query.form == "DESCRIBE" or _names_any(query.where):
        return None
    return graphs_around(query.where) or None


def _names_any(group: Group) -> bool:
    """Whether a GRAPH has a variable, which may match any graph even if it contains no pattern."""
    inner = (*group.children, *group.filters)
    return isinstance(group.graph, Variable) or any(map(_names_any, inner))


def _finds_offers(group: Group) -> bool:
    """Whether a pattern may match an affordance or a form."""
    return any(map(_is_of_offers, group.patterns)) or any(map(_finds_offers, (*group.children, *group.filters)))


def _is_of_offers(pattern: Pattern) -> bool:
    if pattern.predicates is None or any(each.startswith(_OFFERS) for each in pattern.predicates):
        return True
    is_typed = isinstance(pattern.object, Iri) and not pattern.object.value.startswith(_OFFERS)
    return TYPE in pattern.predicates and (pattern.repeated or not is_typed)


def _require_own_functions(iris: Iterable[str]) -> None:
    """Raise a 400 Problem for a function that would be one of ours or XPath's: an empty result would be misleading."""
    for iri in sorted(iris):
        for prefix, namespace in (("ros", ros.iri), ("math", PREFIXES["math"])):
            if iri.startswith(namespace) and iri not in OWN:
                names = {each.removeprefix(namespace) for each in OWN if each.startswith(namespace)}
                near = did_you_mean(iri.removeprefix(namespace), names)
                more = "" if near else f" There are {', '.join(sorted(names))}."
                raise Problem(400, f"{prefix}:{iri.removeprefix(namespace)} is not a SPARQL function{near}.{more}")


def parse_problem(error: QueryError, text: str) -> Problem:
    """Return the problem of a query that only the store's parser rejects; `text` is the parsed text.

    The parser's list of expected tokens is left out: it does not help users.
    """
    where = _PLACE.match(str(error))
    if where is None:
        return Problem(400, f"The query was rejected: {error}.")
    is_as_written = NAMESPACE not in text
    return Problem(400, f"The query cannot be parsed{f' at {where[1]}' if is_as_written else ''}.")


_PLACE = re.compile(r"error at (\d+:\d+): ")
