"""Deprecated terms of the ontology in the text of a query, which finds nothing by them."""

from __future__ import annotations

import re
from functools import cache

from rosld.ontology.modules import successors
from rosld.ontology.vocab import PREFIXES

_PREFIX = re.compile(r"\bPREFIX\s+([\w.-]*):\s*<([^<>\s]*)>", re.IGNORECASE)


def find_deprecated_terms(text: str) -> dict[str, str]:
    """The deprecated terms that a query names, each with a sentence about what has taken its place.

    The text alone is looked at, so that what cannot be parsed is told of, too.
    """
    candidates = _names().findall(text)
    if not candidates:
        return {}
    prefixes = {**PREFIXES, **dict(_PREFIX.findall(text))}
    named = {prefixes.get(prefix, "") + local for prefix, local in candidates}
    return {iri: _sentence(iri) for iri in successors() if iri in named or f"<{iri}>" in text}


@cache
def _names() -> re.Pattern[str]:
    """Prefixes and local names that may be those of deprecated terms; in an IRI the prefix is empty."""
    names = "|".join(sorted({re.escape(iri.rpartition("#")[2]) for iri in successors()}))
    return re.compile(rf"((?<![\w.-])[\w.-]{{0,64}})[:#]({names})(?![\w-])")


def _sentence(iri: str) -> str:
    return f"{_short(iri)} is deprecated: {' or '.join(map(_short, successors()[iri]))} has taken its place."


def _short(iri: str) -> str:
    """A term as people write it."""
    found = (f"{prefix}:{iri[len(space) :]}" for prefix, space in PREFIXES.items() if iri.startswith(space))
    return next(found, iri)
