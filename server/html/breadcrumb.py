"""The breadcrumb: from the entry point through the namespaces to the page, taken from its URL."""

from __future__ import annotations

from rosld.server.html.site import Anchor, Site, readable_path
from rosld.server.html.view import escape_controls

_CONTAINERS = {"bags": "recordings"}
"""Containers at the top that are called otherwise than in URLs."""


def breadcrumb(site: Site, url: str) -> tuple[Anchor, ...]:
    """A link for each level above `url` and, last, one for itself; none for URLs that are not of this site."""
    path = url.partition("#")[0].partition("?")[0]
    if not path.startswith(site.base):
        return ()
    parts = path.removeprefix(site.base).split("/")
    leaf = parts.pop()
    crumbs = [_crumb(site, site.base, site.name)]
    here = site.base
    for part in parts:
        here = f"{here}{part}/"
        crumbs.append(_crumb(site, here, _words(part) if len(crumbs) > 1 else _CONTAINERS.get(part) or _words(part)))
    if leaf:
        crumbs.append(_crumb(site, f"{here}{leaf}", _words(leaf)))
    return tuple(crumb for crumb in crumbs if crumb.url == path or site.may("GET", crumb.url))


def _crumb(site: Site, url: str, text: str) -> Anchor:
    return Anchor(site.href(url) or "", text, url)


def _words(segment: str) -> str:
    text = readable_path(segment)
    return escape_controls(text[1:] if text.startswith("~") else text) or "(empty)"
