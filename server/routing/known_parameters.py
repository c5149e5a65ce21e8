"""Query parameters that are known: those that the path item of a resource declares, and no others.

A misspelt parameter would have a request mean something else than was asked, such as a hold of another length.
"""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches

from rosld.ontology.lift import LiftSettings
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.rest.exchange import query_pairs
from rosld.server.rest.path_item import OF_EVERY_WRITE, PathItem
from rosld.server.rest.resource import Resource

_LONGEST = 100
"""Characters of a parameter that are repeated to who sent it."""
_RECEIPT = "receipt"
"""The parameter of the page that a form leads to."""


class KnownParameters:
    """Refuses parameters that no path item declares, and those that are given twice where one counts."""

    def __init__(self, lifting: LiftSettings) -> None:
        self._schemas = MessageSchemas(lambda ref: None, lifting)

    def require(self, method: str, query_string: bytes, *resources: Resource, is_form: bool = False) -> None:
        """Raise a 400 Problem where a write has a parameter that none of the resources declares for its method.

        A form is sent to the URL of its page, and may have the parameters of that.
        """
        if any(method in resource.passes_unknown_parameters for resource in resources):
            return
        known = dict.fromkeys((each.name for each in OF_EVERY_WRITE), False)
        for resource in dict.fromkeys(resources):
            item = resource.path_item(self._schemas)
            if method in item.writes:
                known |= {each.name: each.is_list for each in item.writes[method].query}
            if is_form:
                known |= _of_page(item)
        names = [name for name, _ in query_pairs(query_string)]
        for problem in _problems(method, names, known):
            raise problem


def _of_page(item: PathItem) -> dict[str, bool]:
    """The parameters of a page, each with whether it may be given several times."""
    return {**dict.fromkeys((_RECEIPT, *item.shared_query), False), **{each.name: each.is_list for each in item.query}}


def _problems(method: str, names: list[str], known: dict[str, bool]) -> Iterator[Problem]:
    """What is wrong with parameters: not known, or there twice and no list."""
    for place, name in enumerate(names):
        shown = name[:_LONGEST]
        if name not in known:
            nearest = get_close_matches(shown, known, n=1, cutoff=0.0)[0]
            there = ", ".join(f"?{each}" for each in sorted(known))
            words = f"{method} has no parameter ?{shown} here; the nearest is ?{nearest}. There are {there}."
            yield Problem(400, words)
        elif name in names[:place] and not known[name]:
            yield Problem(400, f"?{shown} is there more than once, and only one would count: leave out the others.")
