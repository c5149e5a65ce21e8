"""Hosts and origins that may use this server: Host (RFC 9110 7.2), Origin (RFC 6454), CORS (Fetch), CSRF tokens.

A robot on a user's own machine can be reached from every page in the user's browser. So a request must name this server
(against DNS rebinding), and a request that may change something must not be sent by a foreign page.
"""

from __future__ import annotations

import hmac
import secrets
from base64 import urlsafe_b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import urlsplit

from msgspec import Struct

from rosld.server.http.problem import Problem

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
_DEFAULT_PORTS = {"http": 80, "https": 443}
_OWN_FETCH_SITES = (None, "same-origin", "none")
_METHODS = "GET, HEAD, OPTIONS, PUT, POST, PATCH, DELETE"
_READS = "GET, HEAD, OPTIONS"
_REQUEST_HEADERS = (
    "Accept, Content-Type, If-Match, If-None-Match, Prefer, Link, Slug, Idempotency-Key, Last-Event-ID, traceparent, "
    "X-Request-Id"
)
_NAMED_HEADERS = f"{_REQUEST_HEADERS}, Authorization"
_EXPOSED = (
    "ETag, Link, Location, Content-Location, Allow, Accept-Post, Accept-Patch, Accept-Put, Age, Retry-After, "
    "Preference-Applied, Unread-Graphs, WAC-Allow, WWW-Authenticate, X-Request-Id"
)
ANY_ORIGIN = "*"
"""Value of `--cors-origin` that shares reads with every page; writes still require a listed origin."""


class OriginPolicy(Struct, frozen=True):
    """This server's names: its base, the accepted Hosts, its own origins and those it shares with.

    `allows_any_origin`: pages of every origin may read.
    """

    base: str
    hosts: frozenset[str]
    origins: frozenset[str]
    shared_origins: frozenset[str] = frozenset()
    allows_any_origin: bool = False


def origin_policy(base: str, bound_host: str, bound_port: int, shared: Iterable[str] = ()) -> OriginPolicy:
    """Return the names of a server with this base URL, bound to this address.

    Accepted are those of the base and, if the address is loopback, the loopback names with the bound port.
    """
    scheme, authority = _split(base)
    hosts, origins = {authority}, {f"{scheme}://{authority}"}
    if is_loopback(bound_host):
        local = {normalize_authority(f"{name}:{bound_port}", "http") for name in _LOOPBACK_NAMES}
        hosts |= local
        origins |= {f"{each}://{name}" for name in local for each in ("http", scheme)}
    named = frozenset(map(normalize_origin, shared))
    return OriginPolicy(base, frozenset(hosts), frozenset(origins), named - {ANY_ORIGIN}, ANY_ORIGIN in named)


def is_loopback(host: str) -> bool:
    """Whether an address to bind to is only reachable from this machine."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def is_wildcard(host: str) -> bool:
    """Whether an address to bind to means all addresses of this machine."""
    try:
        return ip_address(host.strip("[]")).is_unspecified
    except ValueError:
        return host in ("", "*")


def normalize_authority(authority: str, scheme: str) -> str:
    """Return an authority in lower case, without the default port of its scheme or a final dot of its name."""
    name, colon, port = authority.lower().rpartition(":")
    if not colon or not (port.isdigit() or not port):
        name, port = authority.lower(), ""
    name = name.removesuffix(".")
    return name if not port or int(port) == _DEFAULT_PORTS.get(scheme) else f"{name}:{int(port)}"


def normalize_origin(origin: str) -> str:
    """Return an origin as browsers write it (RFC 6454 6.2). Raises ValueError for an invalid one."""
    if origin == ANY_ORIGIN:
        return origin
    scheme, authority = _split(origin)
    return f"{scheme}://{authority}"


def check_host(site: OriginPolicy, hosts: Sequence[str]) -> None:
    """Raise a Problem unless the request names this server: 400 without exactly one Host, 421 for another host."""
    if len(hosts) != 1:
        raise Problem(400, f"The request has {len(hosts)} Host headers; send exactly one (RFC 9112 3.2).")
    named = hosts[0]
    if named not in site.hosts and normalize_authority(named, urlsplit(site.base).scheme) not in site.hosts:
        raise Problem(421, f"Unknown host {named[:200]!r}. This server is {site.base}", extra={"base": site.base})


def check_origin(site: OriginPolicy, method: str, origin: str | None, fetch_site: str | None = None) -> None:
    """Raise a 403 Problem for an unsafe method from a foreign page.

    A request without Origin is not from a page (but from curl or a robot), unless Sec-Fetch-Site indicates one.
    """
    if method in SAFE_METHODS:
        return
    if origin is None and fetch_site in _OWN_FETCH_SITES:
        return
    if origin is None or not (origin.lower() in site.origins or origin in site.shared_origins):
        raise Problem(
            403,
            f"Pages of {(origin or 'another site')[:200]!r} may not change anything here. To allow it, start the "
            "server with --cors-origin.",
        )


def cors_headers(site: OriginPolicy, method: str, origin: str | None, *, preflight: bool = False) -> Mapping[str, str]:
    """Return the CORS headers of a response: none for an origin that nothing is shared with.

    `preflight`: the request is an OPTIONS with Access-Control-Request-Method. They include `vary` if the response
    depends on the origin; the caller adds it to the response's own Vary.
    """
    headers = {"vary": "Origin"} if site.shared_origins or site.allows_any_origin else {}
    named = origin in site.shared_origins
    if origin is None or not (named or (site.allows_any_origin and method in SAFE_METHODS)):
        return headers
    headers["access-control-allow-origin"] = origin if named else ANY_ORIGIN
    if preflight:
        return headers | {
            "access-control-allow-methods": _METHODS if named else _READS,
            "access-control-allow-headers": _NAMED_HEADERS if named else _REQUEST_HEADERS,
            "access-control-max-age": "600",
        }
    return headers | {"access-control-expose-headers": _EXPOSED}


def _split(url: str) -> tuple[str, str]:
    """Return the scheme and the normalized authority of an http(s) URL. Raises ValueError."""
    parts = urlsplit(url)
    if parts.scheme not in _DEFAULT_PORTS or not parts.hostname or parts.username is not None:
        raise ValueError(f"{url!r} is not an http or https URL")
    assert parts.port is None or parts.port >= 0  # reading it raises ValueError for a bad one
    return parts.scheme, normalize_authority(parts.netloc, parts.scheme)


CSRF_FIELD = "csrf"
"""Name of the hidden form field."""


@dataclass(frozen=True, slots=True)
class FormKey:
    """The secret key of form tokens, which differs in each run of the server."""

    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)

    def token(self, action: str) -> str:
        """Return the token for a form that posts to `action` (a URL)."""
        mac = hmac.digest(self.key, b"form " + action.encode("utf-8", "surrogatepass"), "sha256")
        return urlsafe_b64encode(mac).decode().rstrip("=")

    def is_valid(self, token: str, action: str) -> bool:
        """Whether `token` was made for `action` in this run; takes constant time for all wrong tokens."""
        return hmac.compare_digest(token.encode("utf-8", "replace"), self.token(action).encode())

    def require(self, token: str | None, action: str) -> None:
        """Raise a 403 Problem unless the token is valid."""
        if token is None or not self.is_valid(token, action):
            raise Problem(
                403, "The server was restarted since this form was loaded. Reload the page and submit the form again."
            )
