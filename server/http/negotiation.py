"""Proactive negotiation (RFC 9110 12.5.1): which of the offered media types a client wants most.

One negotiation for everything that has representations: RDF syntaxes, SPARQL results, errors, pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from rosld.server.http import header_syntax, media
from rosld.server.http.media import MediaType

_WEIGHT = re.compile(r"0(\.[0-9]{0,3})?|1(\.0{0,3})?")
_RDF_XML = "application/rdf+xml"
_XML = frozenset({"application/xml", "text/xml"})
_LONGEST_CACHED = 1024
_WISHES = frozenset({"profile", "version"})
"""Parameters that state a wish and exclude nothing: JSON-LD's profile (its registration says so) and RDF's version."""


@dataclass(frozen=True, slots=True)
class MediaRange:
    """One member of an Accept field: a media type, perhaps with wildcards, and its weight from 0 to 1."""

    media: MediaType
    weight: float

    def matches(self, offer: MediaType) -> bool:
        """Whether the range includes the offer. Everything offered is UTF-8, so `charset=utf-8` always fits."""
        return (
            self.media.type in ("*", offer.type)
            and self.media.subtype in ("*", offer.subtype)
            and all(_fits(name, value, offer) for name, value in self.media.parameters)
        )

    @property
    def specificity(self) -> tuple[bool, bool, int]:
        """Sorts ranges: the more specific is the greater (RFC 9110 12.5.1)."""
        return (self.media.type != "*", self.media.subtype != "*", len(self.media.parameters))


def choose(accept: str | None, offers: tuple[str, ...]) -> str | None:
    """The offer a client prefers, None where none is acceptable (406).

    `offers` are media types, the server's favourite first: it wins ties, and whatever is asked for when the field is
    missing or empty. Members that are malformed are passed over; a field with no valid member is as good as missing.
    Who accepts nothing that is offered but XML gets RDF/XML, which is XML (RFC 3870).
    """
    if accept is None or len(accept) > _LONGEST_CACHED:
        return _choose(accept, offers)
    return _remembered(accept, offers)


def _choose(accept: str | None, offers: tuple[str, ...]) -> str | None:
    if accept is None or not accept.strip(" \t,"):
        return offers[0] if offers else None
    ranges = tuple(parse(accept))
    if not ranges:
        return offers[0] if offers else None
    best, best_weight = None, 0.0
    for offer in offers:
        weight = quality(media.parse(offer), ranges)
        if weight > best_weight:
            best, best_weight = offer, weight
    if best is None and _RDF_XML in offers and any(one.weight and one.media.essence in _XML for one in ranges):
        return _RDF_XML
    return best


_remembered = lru_cache(maxsize=1024)(_choose)


def quality(offer: MediaType, ranges: tuple[MediaRange, ...]) -> float:
    """The weight of an offer: that of the most specific range which includes it, 0 where none does."""
    including = [one for one in ranges if one.matches(offer)]
    return max(including, key=lambda one: one.specificity).weight if including else 0.0


def parse(accept: str) -> Iterator[MediaRange]:
    """The valid members of an Accept field, in order."""
    for member in header_syntax.split(accept, ","):
        try:
            yield _range(member)
        except ValueError:
            continue


def _range(member: str) -> MediaRange:
    essence, *rest = header_syntax.split(member, ";")
    weight, kept = 1.0, [essence]
    for part in rest:
        if part[:1] in "qQ" and header_syntax.parse_parameter(part)[0] == "q":
            weight = _weight(header_syntax.parse_parameter(part)[1])
            break  # what follows are accept-ext, which RFC 9110 took out of the grammar
        kept.append(part)
    found = media.parse(";".join(kept))
    if found.type == "*" and found.subtype != "*":
        raise ValueError(f"{member!r} is no media range")
    return MediaRange(found, weight)


def _weight(text: str) -> float:
    if not _WEIGHT.fullmatch(text):
        raise ValueError(f"{text!r} is no weight: 0 to 1 with at most three decimals")
    return float(text)


def _fits(name: str, value: str, offer: MediaType) -> bool:
    if name in _WISHES:
        return True
    stated = offer.parameter(name)
    return stated == value or (name == "charset" and stated is None and value in ("utf-8", "utf8"))
