"""Permissions of one agent on the URLs of one server. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import TypeAlias

from rosld.ontology.urls import Location, Space
from rosld.server.auth.rules import ANONYMOUS, UNTYPED, Agent, Mode, Rights, Types, allow_all_rules, mode_of, path_at
from rosld.server.auth.tokens import token_digest

TypesAt: TypeAlias = Callable[[Location], Types]
"""Function that returns the types of the resource at a location."""
AboutAt: TypeAlias = Callable[[Location], "Sequence[str] | None"]
"""Function that returns the URLs of a resource's subjects; reading the resource requires reading all of them.

It returns None if they are unknown: then reading requires the right to read everything. Thread-safe.
"""
ABOUT_OTHERS = frozenset({"activity", "bags", "calls", "channels", "faults", "goals", "holds"})
"""Routes of resources about other resources: the service of a call, the targets of a receipt's write."""

_PAGE = re.compile(r"(?:^|&)page=[0-9]*:([^&]+)")


def _untyped(location: Location) -> Types:
    return UNTYPED


def _about_nothing_else(location: Location) -> Sequence[str]:
    return ()


def _about_unknown(location: Location) -> Sequence[str] | None:
    """Return None: worker processes do not know the subjects of calls, receipts and recordings."""
    return None if location.kind in ABOUT_OTHERS and location.segments else ()


class Permissions:
    """Permissions of an agent with these rights on the URLs of a space; URLs of other servers are always readable.

    `is_unrestricted`: everything is permitted, so that no checks are needed. `rights_key` is equal for equal rights,
    and the key of caches for them.
    """

    def __init__(
        self,
        agent: Agent,
        rights: Rights,
        space: Space | None = None,
        types: TypesAt = _untyped,
        about: AboutAt = _about_nothing_else,
    ) -> None:
        self.agent = agent
        self.rights = rights
        self.is_unrestricted = rights.is_unrestricted
        self.may_read_all = rights.may_read_all
        self.rights_key = "" if self.is_unrestricted else rights.key
        self.cache_key = "" if agent == ANONYMOUS else f"-{token_digest(agent.name)[-12:]}"
        """Cache key of content for this agent alone."""
        self._space = space
        self._types = types
        self._about = about
        self._located = lru_cache(maxsize=16384)(self._locate)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle for a worker process. Raises TypeError for rights with types, which only the server knows."""
        if self.rights.is_typed:
            raise TypeError("rights that depend on types are judged in the server only")
        return Permissions, (self.agent, Rights(self.rights.rules), self._space, _untyped, _about_unknown)

    def within(self, url: str) -> Permissions:
        """Return the permissions that judge names in the document at a URL, such as those of its robot's topics."""
        return self

    def may_read(self, url: str) -> bool:
        """Whether a URL may be read, regardless of its query and fragment."""
        return self.may("GET", url)

    def may(self, method: str, url: str) -> bool:
        """Whether a request with this method may be made of this URL."""
        if self.is_unrestricted:
            return True
        location = self._located(url)
        if location is None:
            return self._space is None or not url.startswith(self._space.base)
        return self.may_at(method, location) and self._may_know_page(url)

    def _may_know_page(self, url: str) -> bool:
        """Whether the member in the URL of a page (`?page=:NAME`), if it is one, may be read."""
        container, _, query = url.partition("#")[0].partition("?")
        found = _PAGE.search(query)
        return found is None or self.may_read(container + found[1])

    def locate(self, url: str) -> Location | None:
        """Return the location of a URL, or None for another server."""
        return self._located(url)

    def may_at(self, method: str, location: Location) -> bool:
        """Whether a request with this method may be made of the resource at a location."""
        path = path_at(location)
        if method == "OPTIONS":
            return self.may_know(location)
        return self.rights.may(mode_of(method, path), path, self._types(location)) and self.may_about(method, location)

    def may_about(self, method: str, location: Location) -> bool:
        """Whether the subjects of a resource permit an operation that its path permits.

        What is denied is denied wherever it is mentioned: reading the resource requires the right to read all its
        subjects, changing it the right to know of all of them.
        """
        if self.may_read_all or location.kind not in ABOUT_OTHERS:
            return True
        about = self._about(location)
        if about is None:
            return False
        is_read = mode_of(method, path_at(location)) is Mode.READ
        return all(self.may_read(url) if is_read else self._may_know_url(url) for url in about)

    def may_read_topic(self, name: str) -> bool:
        """Whether the topic of this name may be read; a glob is treated as a name."""
        return self._space is None or self.may_read(self._space.topic(name if name.startswith("/") else f"/{name}"))

    def may_know(self, location: Location) -> bool:
        """Whether the agent may know if anything exists at a location, or at one of its subjects."""
        if self.is_unrestricted:
            return True
        if not self.rights.may_know(path_at(location), self._types(location)):
            return False
        if self.may_read_all or location.kind not in ABOUT_OTHERS:
            return True
        about = self._about(location)
        quantifier = all if location.kind == "faults" else any  # ids of faults are digests of what was reported
        return about is not None and (not about or quantifier(map(self._may_know_url, about)))

    def _may_know_url(self, url: str) -> bool:
        location = self._located(url)
        return location is None or self.may_know(location)

    def may_know_path(self, location: Location) -> bool:
        """Whether the agent may know if anything exists at a location, judged by the path alone."""
        return self.is_unrestricted or self.rights.may_know(path_at(location), None)

    def may_know_any_type(self, location: Location) -> bool:
        """Whether the agent may know if anything of any type exists at a location."""
        return self.is_unrestricted or self.rights.may_know_any_type(path_at(location))

    def may_subtree(self, method: str, location: Location) -> bool:
        """Whether a request is permitted at a location and everywhere below, for any type."""
        path = path_at(location)
        return self.is_unrestricted or self.rights.may_subtree(mode_of(method, path), path)

    def may_template(self, method: str, url: str) -> bool:
        """Whether a request is permitted at a URL, or at one that a template (`/data/{name}`) matches."""
        if "{" not in url:
            return self.may(method, url)
        place = self._located(url.partition("{")[0])
        return self.is_unrestricted or (
            place is not None and self.rights.may_in_subtree(mode_of(method, path_at(place)), path_at(place))
        )

    def allowed_methods(self, methods: Iterable[str], url: str) -> frozenset[str]:
        """Return the methods that the agent may use at a location."""
        return (
            frozenset(methods) if self.is_unrestricted else frozenset(each for each in methods if self.may(each, url))
        )

    def modes(self, location: Location) -> frozenset[Mode]:
        """Return the permitted modes at a location."""
        path, types = path_at(location), self._types(location)
        return frozenset(mode for mode in Mode if self.rights.may(mode, path, types))

    def _locate(self, url: str) -> Location | None:
        return None if self._space is None else self._space.location(url)


ALLOW_ALL = Permissions(ANONYMOUS, Rights(allow_all_rules()))
"""Permissions on a server without rules."""
