"""Content Negotiation by Profile (W3C): `Accept-Profile`, `?_profile=`, and `Prefer: profile=`."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.server.http import header_syntax
from rosld.server.http.prefer import Preferences

QUERY = "_profile"
VARY = "Accept, Accept-Profile, Prefer"


def choose_profile(
    offers: Mapping[str, str], accept_profile: str | None, prefer: Preferences, query: str | None
) -> str | None:
    """The profile to answer in, by its IRI; None where the request names none that is offered.

    `offers` are IRIs by their short names, which the query may have. The query goes before the headers, and among
    several in `Accept-Profile` the highest quality wins, the first of equals.
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
    """The IRIs of an Accept-Profile field, those that are wanted most first; malformed members are passed over."""
    found: list[tuple[float, str]] = []
    for member in header_syntax.split(text, ","):
        iri, *parameters = (part.strip() for part in header_syntax.split(member, ";"))
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
