"""Content negotiation: media types and Accept (RFC 9110 8.3.1 and 12.5.1), Prefer (RFC 7240), Accept-Profile (W3C)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache

from msgspec import Struct, field

from rosld.server.http.fields import is_token, parse_parameter, quote_string, require_field_value, split_members


class MediaType(Struct, frozen=True):
    """A media type or range: type and subtype in lower case, parameters sorted by lower-case name.

    The value of `charset` is in lower case too, because it is case-insensitive (RFC 9110 8.3.2).
    """

    type: str
    subtype: str
    parameters: tuple[tuple[str, str], ...] = ()

    @property
    def essence(self) -> str:
        """The `type/subtype` without parameters."""
        return f"{self.type}/{self.subtype}"

    def parameter(self, name: str) -> str | None:
        """Return the value of a parameter, None if it is missing."""
        return dict(self.parameters).get(name) if self.parameters else None

    def __str__(self) -> str:
        return self.essence + "".join(
            f";{name}={value if is_token(value) else quote_string(value)}" for name, value in self.parameters
        )


@lru_cache(maxsize=256)
def parse_media_type(text: str) -> MediaType:
    """Return the media type in `text`, such as a Content-Type. Raises ValueError naming the error."""
    essence, *rest = split_members(text, ";") or [""]
    kind, slash, subtype = essence.partition("/")
    if not slash or not is_token(kind) or not is_token(subtype):
        raise ValueError(f"{text!r} is not a media type such as text/turtle")
    parameters: dict[str, str] = {}
    for part in rest:
        name, value = parse_parameter(part)
        if name in parameters:
            raise ValueError(f"the parameter {name!r} occurs twice in {text!r}")
        parameters[name] = value.lower() if name == "charset" else value
    return MediaType(kind.lower(), subtype.lower(), tuple(sorted(parameters.items())))


_WEIGHT = re.compile(r"0(\.[0-9]{0,3})?|1(\.0{0,3})?")
_RDF_XML = "application/rdf+xml"
_XML = frozenset({"application/xml", "text/xml"})
_LONGEST_CACHED = 1024
_WISHES = frozenset({"profile", "version"})
"""Parameters that exclude no offer: JSON-LD's profile (according to its registration) and RDF's version."""


class MediaRange(Struct, frozen=True):
    """A member of an Accept field: a media type, possibly with wildcards, and its weight from 0 to 1."""

    media: MediaType
    weight: float

    def matches(self, offer: MediaType) -> bool:
        """Whether the range includes the offer. All offers are UTF-8, so `charset=utf-8` always matches."""
        return (
            self.media.type in ("*", offer.type)
            and self.media.subtype in ("*", offer.subtype)
            and all(_fits(name, value, offer) for name, value in self.media.parameters)
        )

    @property
    def specificity(self) -> tuple[bool, bool, int]:
        """Sort key of ranges: the more specific one is greater (RFC 9110 12.5.1)."""
        return (self.media.type != "*", self.media.subtype != "*", len(self.media.parameters))


def choose_offer(accept: str | None, offers: tuple[str, ...]) -> str | None:
    """Return the offer that a client prefers, None if none is acceptable (406).

    `offers` are media types in the server's order of preference: the first wins ties, and is the result if the field is
    missing or empty. Malformed members are ignored; a field without a valid member counts as missing. A client that
    accepts XML and none of the offers gets RDF/XML, which is XML (RFC 3870).
    """
    if accept is None or len(accept) > _LONGEST_CACHED:
        return _choose_offer(accept, offers)
    return _remembered(accept, offers)


def _choose_offer(accept: str | None, offers: tuple[str, ...]) -> str | None:
    if accept is None or not accept.strip(" \t,"):
        return offers[0] if offers else None
    ranges = tuple(parse_accept(accept))
    if not ranges:
        return offers[0] if offers else None
    best, best_weight = None, 0.0
    for offer in offers:
        weight = quality(parse_media_type(offer), ranges)
        if weight > best_weight:
            best, best_weight = offer, weight
    if best is None and _RDF_XML in offers and any(one.weight and one.media.essence in _XML for one in ranges):
        return _RDF_XML
    return best


_remembered = lru_cache(maxsize=1024)(_choose_offer)


def quality(offer: MediaType, ranges: tuple[MediaRange, ...]) -> float:
    """Return the weight of an offer: that of the most specific range that includes it, or 0."""
    including = [one for one in ranges if one.matches(offer)]
    return max(including, key=lambda one: one.specificity).weight if including else 0.0


def parse_accept(accept: str) -> Iterator[MediaRange]:
    """Yield the valid members of an Accept field, in order."""
    for member in split_members(accept, ","):
        try:
            yield _range(member)
        except ValueError:
            continue


def _range(member: str) -> MediaRange:
    essence, *rest = split_members(member, ";")
    weight, parts = 1.0, [essence]
    for part in rest:
        if part[:1] in "qQ" and parse_parameter(part)[0] == "q":
            weight = _weight(parse_parameter(part)[1])
            break  # accept-ext follows, which RFC 9110 removed from the grammar
        parts.append(part)
    found = parse_media_type(";".join(parts))
    if found.type == "*" and found.subtype != "*":
        raise ValueError(f"{member!r} is not a media range")
    return MediaRange(found, weight)


def _weight(text: str) -> float:
    if not _WEIGHT.fullmatch(text):
        raise ValueError(f"{text!r} is not a weight: use 0 to 1 with at most three decimals")
    return float(text)


def _fits(name: str, value: str, offer: MediaType) -> bool:
    if name in _WISHES:
        return True
    stated = offer.parameter(name)
    return stated == value or (name == "charset" and stated is None and value in ("utf-8", "utf8"))


Parameters = tuple[tuple[str, str], ...]


class Preference(Struct, frozen=True):
    """A preference: its value ("" for none; RFC 7240 2 treats both alike) and its parameters."""

    value: str = ""
    parameters: Parameters = ()


class Preferences(Struct, frozen=True):
    """Preferences of a request by lower-case name; the first of several with the same name counts (RFC 7240 2)."""

    named: Mapping[str, Preference] = field(default_factory=dict)

    def value(self, name: str) -> str | None:
        """Return the value of a preference in lower case, None if it is missing."""
        found = self.named.get(name)
        return None if found is None else found.value.lower()

    @property
    def minimal(self) -> bool:
        """Whether return=minimal is preferred (RFC 7240 4.2)."""
        return self.value("return") == "minimal"

    @property
    def representation(self) -> bool:
        """Whether return=representation is preferred (RFC 7240 4.2)."""
        return self.value("return") == "representation"

    @property
    def wait(self) -> int | None:
        """Seconds of wait=SECONDS (RFC 7240 4.3), None if it is missing or not a whole number."""
        value = self.value("wait") or ""
        return int(value) if value.isascii() and value.isdigit() and len(value) < 10 else None

    @property
    def include(self) -> frozenset[str]:
        """URIs of `include` of return=representation (LDP 7.2.2)."""
        return self._uris("include")

    @property
    def omit(self) -> frozenset[str]:
        """URIs of `omit` of return=representation (LDP 7.2.2)."""
        return self._uris("omit")

    def _uris(self, name: str) -> frozenset[str]:
        found = self.named.get("return") if self.representation else None
        return frozenset(
            uri for key, value in (found.parameters if found else ()) if key == name for uri in value.split()
        )


NO_PREFERENCES = Preferences()


def parse_prefer(text: str | None) -> Preferences:
    """Return the preferences in a Prefer field. Malformed members are ignored."""
    if text is None:
        return NO_PREFERENCES
    named: dict[str, Preference] = {}
    for member in split_members(text, ","):
        try:
            name, preference = _preference(member)
        except ValueError:
            continue
        named.setdefault(name, preference)
    return Preferences(named)


def preference_applied(*names: str) -> str:
    """Return the value of Preference-Applied for preferences such as `return=representation` (RFC 7240 3)."""
    return require_field_value(", ".join(names))


def _preference(member: str) -> tuple[str, Preference]:
    head, *rest = split_members(member, ";")
    name, value = parse_parameter(head)
    return name, Preference(value, tuple(parse_parameter(part) for part in rest))


PROFILE_QUERY = "_profile"
VARY_PROFILE = "Accept, Accept-Profile, Prefer"


def choose_profile(
    offers: Mapping[str, str], accept_profile: str | None, prefer: Preferences, query: str | None
) -> str | None:
    """Return the IRI of the profile of the response, None if the request names no offered one.

    `offers` are IRIs by short name, which the query may contain. The query takes precedence over the headers; in
    `Accept-Profile` the highest quality wins, and the first of equals.
    """
    if query is not None:
        return offers.get(query) or (query if query in offers.values() else None)
    for iri in _by_quality(accept_profile or ""):
        if iri in offers.values():
            return iri
    preferred = prefer.named.get("profile")
    wanted = None if preferred is None else preferred.value.strip("<>")
    return wanted if wanted in offers.values() else offers.get(wanted or "")


def _by_quality(text: str) -> list[str]:
    """Return the IRIs in an Accept-Profile field by descending quality; malformed members are ignored."""
    found: list[tuple[float, str]] = []
    for member in split_members(text, ","):
        iri, *parameters = (part.strip() for part in split_members(member, ";"))
        quality = 1.0
        for parameter in parameters:
            name, _, value = parameter.partition("=")
            if name.strip().lower() == "q":
                try:
                    quality = float(value)
                except ValueError:
                    quality = 0.0
        if iri.startswith("<") and iri.endswith(">") and quality > 0:
            found.append((-quality, iri[1:-1]))
    return [iri for _, iri in sorted(found, key=lambda each: each[0])]
