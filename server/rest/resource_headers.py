"""Headers that every answer about a resource has, whatever its state: Allow, Link, Accept-*."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from rosld.server.http.fields import Link, render_links
from rosld.server.rest.resource import CONFORMS_TO, LDP, Resource

ACCEPT_FIELDS = {"PUT": "Accept-Put", "POST": "Accept-Post", "PATCH": "Accept-Patch"}


def resource_headers(
    resource: Resource, methods: frozenset[str] | None = None, shapes: Sequence[str] = ()
) -> dict[str, str]:
    """The headers every answer about a resource has: Allow, Link, and Accept-* for the writes that it takes now.

    `methods` are those it answers, where more is known of them than the resource says without being read; `shapes` are
    what its state conforms to beside the shape of its class.
    """
    methods = (resource.methods() if methods is None else methods) - resource.withheld
    links = (*resource.links, *(Link(url, CONFORMS_TO) for url in (*resource.conforms_to, *shapes)))
    if resource.constrained_by is not None:
        links = (*links, Link(resource.constrained_by, f"{LDP}constrainedBy"))
    headers = {"allow": ", ".join(sorted(methods))}
    if links:
        headers["link"] = rendered(links)
    for method, accepted in resource.accepts.items():
        if method in methods:
            headers[ACCEPT_FIELDS[method].lower()] = ", ".join(accepted)
    return headers


rendered = lru_cache(maxsize=4096)(render_links)
"""The Link field of links that are the same from one request to the next."""
