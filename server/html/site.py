"""The site that contains the pages: its base URL, and how pages show and link URLs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

from msgspec import Struct

from rosld.ontology.modules import term_url
from rosld.ontology.urls import TYPES, locate
from rosld.ontology.vocab import PREFIXES, ros

SECTIONS = (
    "resources",
    "nodes",
    "topics",
    "services",
    "actions",
    "parameters",
    "types",
    "mappings",
    "data",
    "queries",
)
"""The containers in the navigation of every page."""

_NAMED = frozenset({"nodes", "topics", "services", "actions", "parameters", "resources"})
_UNSAFE = re.compile(r"[\x00-\x20\x7f-\xa0\\\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def _anything(method: str, url: str) -> bool:
    return True


class Anchor(Struct, frozen=True):
    """A link as shown: its target, its short text, its full URL, and whether it leaves this server."""

    href: str
    text: str
    url: str
    external: bool = False


@dataclass(frozen=True, slots=True)
class Site:
    """A rosld server: its canonical base URL (ending in a slash), its containers, and its state.

    `stale` says since when and why the robot is unreachable; None if it is reachable.
    """

    base: str
    name: str
    system: str = "ROS"
    stale: str | None = None
    read_only: bool = False
    sections: tuple[str, ...] = SECTIONS
    types: str = TYPES
    vocabulary: str = ros.iri
    stop_token: str = ""
    """CSRF token of the form that stops the robot; empty if the reader cannot stop it."""
    stopped: str = ""
    """Sentence that says who stopped the robot, when and why; empty if it is not stopped."""
    stop_warning: str = ""
    """Why the robot may still move although it is stopped, as a sentence, or empty."""
    may: Callable[[str, str], bool] = field(default=_anything, compare=False)
    """Permission of the reader for a method at a URL."""
    may_subtree: Callable[[str, str], bool] = field(default=_anything, compare=False)
    """Permission of the reader for a method at a URL and everything below it."""
    is_restricted: bool = False
    """Whether there are resources that the reader may not see."""

    def __post_init__(self) -> None:
        if not self.base.endswith("/") or urlsplit(self.base).scheme not in ("http", "https"):
            raise ValueError(f"{self.base!r} is not a base URL: it must be http or https and end with '/'")

    @property
    def root(self) -> str:
        """The path of the base, ending in a slash."""
        return urlsplit(self.base).path

    def page_url(self, iri: str) -> str | None:
        """Return the URL on this server that describes `iri`: `iri` itself, or that of its type or term."""
        if iri.startswith(self.base) or iri == self.base:
            return iri
        if iri.startswith(self.types) and iri != self.types:
            return f"{self.base}types/{iri.removeprefix(self.types)}"
        return term_url(iri, self.base)

    def href(self, iri: str) -> str | None:
        """Return the `href` for `iri`, or None if it must not be a link.

        Only http and https are linked, and resources of this server only if the agent may read them. URLs of this
        server become references without scheme and host (RFC 3986 4.2), so that they work under every host name.
        """
        if _UNSAFE.search(iri) or not iri.lower().startswith(("http://", "https://")):
            return None
        url = self.page_url(iri)
        if url is None:
            return iri
        if not self.may("GET", url):
            return None
        path = self.root + url.removeprefix(self.base)
        return url if path.startswith("//") else path

    def anchor(self, iri: str, here: str = "") -> Anchor | None:
        """Return the link to `iri` on the page at `here`, or None if it must not be a link."""
        href = self.href(iri)
        if href is None:
            return None
        if here and iri.startswith(f"{here}#"):
            fragment = iri.removeprefix(here)
            return Anchor(fragment, readable_path(fragment), iri)
        return Anchor(href, self.short_name(iri), iri, external=self.page_url(iri) is None)

    def short_name(self, iri: str) -> str:
        """Return the name of `iri` on a page: a ROS name, a type's name, `prefix:name`, or the IRI itself."""
        if iri.startswith(self.types):
            return readable_path(iri.removeprefix(self.types))
        if iri.startswith(self.base):
            return self._local_name(iri.removeprefix(self.base))
        return self.prefixed_name(iri)

    def prefixed_name(self, iri: str) -> str:
        """Return `prefix:name` for a term of a known vocabulary, else the IRI."""
        for prefix, namespace in PREFIXES.items():
            if iri.startswith(namespace) and iri != namespace:
                return f"{prefix}:{iri.removeprefix(namespace)}"
        return iri

    def _local_name(self, rest: str) -> str:
        path, hash_, fragment = rest.partition("#")
        path, query_, query = path.partition("?")
        return (_place(path) or self.name) + readable_path(f"{query_}{query}{hash_}{fragment}")


def _place(path: str) -> str:
    """Return the name of the resource at a path: `topics/a/b` is the ROS name `/a/b`, `types/a/b/c` is `a/b/c`."""
    try:
        kind, segments, is_container = locate(f"/{path}")
    except ValueError:
        return readable_path(path)
    if is_container and not segments:
        return f"{kind}/" if kind else ""
    name = "/".join(segments) + ("/" if is_container else "")
    return f"/{name}" if kind in _NAMED else name or kind


def readable_path(path: str) -> str:
    """Return a path for people, with percent-encoding decoded and invalid UTF-8 replaced."""
    return unquote(path, errors="replace")


CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "style-src 'self'",
        "script-src 'self'",
        "connect-src 'self'",
        "img-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
"""Policy of pages: load and run only files of this server, no inline scripts, no requests elsewhere."""

QUERY_EDITOR_POLICY = CONTENT_SECURITY_POLICY.replace("style-src 'self'", "style-src 'self' 'unsafe-inline'")
"""Policy of the page at `/sparql`, whose editor sets inline styles."""

HEADERS: Mapping[str, str] = {
    "content-security-policy": CONTENT_SECURITY_POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
}
"""Headers of every page."""
