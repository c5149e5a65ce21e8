"""Enforcement of permissions by the path of a request, then by its resource; and the headers that describe them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Protocol

from starlette.types import Scope

from rosld.ontology.urls import Location, Space, locate
from rosld.server.auth.errors import forbidden, not_found, not_visible
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_link_field
from rosld.server.auth.rules import ANONYMOUS, Mode, mode_of, path_at
from rosld.server.http.fields import Link

Headers = list[tuple[bytes, bytes]]
_SHORT = 256
"""Maximum number of characters of a path whose location is cached."""
_located = lru_cache(maxsize=8192)(locate)
_READING = frozenset({"GET", "HEAD"})
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_ACCEPTS = {b"accept-put": "PUT", b"accept-post": "POST", b"accept-patch": "PATCH"}
_WORDS = {"PUT": "write this", "POST": "post to this", "PATCH": "change this", "DELETE": "delete this"}


class Protected(Protocol):
    """The properties of a resource that enforcement needs."""

    @property
    def changes_subtree(self) -> bool:
        """Whether writes affect the subtree and therefore need permission for all of it."""
        ...

    @property
    def also_changes(self) -> Sequence[str]:
        """URLs of other resources that writes change."""
        ...

    def methods(self) -> frozenset[str]:
        """Return the currently allowed methods."""
        ...


def location_of(scope: Scope, space: Space) -> Location | None:
    """Return the location of a request, or None if its path is malformed."""
    try:
        path: str = scope["raw_path"].decode("ascii").removeprefix(space.path.rstrip("/"))
        return _located(path) if len(path) <= _SHORT else locate(path)
    except ValueError:
        return None


def require_path(permissions: Permissions, method: str, place: Location | None) -> None:
    """Refuse a request by its path alone, before looking for the resource. Raises 401, 403, 404."""
    if place is None or not permissions.may_know_path(place):
        raise not_visible(permissions.agent)
    if method in _READING and not permissions.rights.may(mode_of(method, path_at(place)), path_at(place), None):
        raise forbidden(permissions.agent, "read this")


def authorize(permissions: Permissions, method: str, place: Location | None, resource: Protected) -> None:
    """Refuse a request on an existing resource if it is not permitted. Raises 401, 403, 404.

    Methods that the resource does not allow (405) are not judged here.
    """
    if place is None or not permissions.may_know(place):
        raise not_found()
    if method == "OPTIONS" or (method not in _SAFE and method not in resource.methods()):
        return
    if not permissions.may_at(method, place):
        what = _WORDS.get(method, "read this")
        if not permissions.may_about(method, place):
            what += ": it also describes resources that you may not read"
        raise forbidden(permissions.agent, what)
    if method in _SAFE:
        return
    if resource.changes_subtree:
        require_subtree(permissions, method, place)
    if not all(permissions.may(method, url) for url in resource.also_changes):
        raise forbidden(permissions.agent, f"{_WORDS[method]}: it also changes resources that you may not change")


def allowed_methods(permissions: Permissions, place: Location, resource: Protected) -> frozenset[str]:
    """Return the methods of a resource that the agent may use."""
    methods = resource.methods()
    if permissions.is_unrestricted:
        return methods
    found = frozenset(each for each in methods if permissions.may_at(each, place))
    writes = found - _SAFE
    if writes and resource.changes_subtree:
        writes = frozenset(each for each in writes if permissions.may_subtree(each, place))
    if writes:
        also = resource.also_changes
        writes = frozenset(each for each in writes if all(permissions.may(each, url) for url in also))
    return (found & _SAFE) | writes


def is_write(method: str, place: Location | None) -> bool:
    """Whether a request would change stored data, or command the robot, if it were permitted."""
    return method in _WORDS and place is not None and mode_of(method, path_at(place)) is not Mode.READ


def require_subtree(permissions: Permissions, method: str, place: Location) -> None:
    """Refuse a change of a subtree if part of it is not permitted. Raises 401, 403."""
    if not permissions.may_subtree(method, place):
        raise forbidden(permissions.agent, f"{_WORDS[method]}: you may not change everything below it")


def with_auth_headers(
    headers: Sequence[tuple[bytes, bytes]],
    permissions: Permissions,
    public: Permissions,
    place: Location | None,
    resource: Protected | None,
    acl: Link,
) -> Headers:
    """Return the headers of a response with the agent's permissions: Allow, WAC-Allow, and a link to the rules.

    `resource` is the resource that answered, None if it is unknown.
    """
    found: Headers = []
    may = (
        None
        if permissions.is_unrestricted or place is None or resource is None
        else allowed_methods(permissions, place, resource)
    )
    links, varies = [str(acl)], ["Authorization"]
    for name, value in headers:
        if name == b"vary":
            varies = [value.decode("latin-1"), *varies]
        elif name == b"link":
            links = [redact_link_field(value.decode("latin-1"), permissions), *links]
        elif permissions.is_unrestricted:
            found.append((name, value))
        elif name == b"allow" and place is not None:
            methods = [each.strip() for each in value.decode("latin-1").split(",")]
            left = [each for each in methods if permissions.may_at(each, place) and (may is None or each in may)]
            found.append((name, ", ".join(left).encode("latin-1")))
        elif name not in _ACCEPTS or _may_use(_ACCEPTS[name], permissions, place, may):
            found.append((name, value))
    found.append((b"vary", ", ".join(varies).encode("latin-1")))
    found.append((b"link", ", ".join(filter(None, links)).encode("latin-1")))
    if place is not None and permissions.may_know(place):
        found.append((b"wac-allow", _wac_allow(permissions, public, place).encode("ascii")))
    return found


def _may_use(method: str, permissions: Permissions, place: Location | None, may: frozenset[str] | None) -> bool:
    """Whether the agent may use a method: one of `may`, or, without a known resource, permitted by the path."""
    if may is not None:
        return method in may
    return place is not None and permissions.may_at(method, place)


def _wac_allow(permissions: Permissions, public: Permissions, place: Location) -> str:
    """Return WAC-Allow (Solid WAC 6.1): `write` if any kind of write is permitted, `control` for the rules."""
    own = public if permissions.agent == ANONYMOUS else permissions
    return f'user="{" ".join(_modes(own, place))}", public="{" ".join(_modes(public, place))}"'


def _modes(permissions: Permissions, place: Location) -> Iterable[str]:
    path, modes = path_at(place), permissions.modes(place)
    if mode_of("GET", path) in modes:
        yield "read"
    if mode_of("PUT", path) in modes:
        yield from ("append", "write")
    if Mode.ADMINISTER in modes:
        yield "control"
