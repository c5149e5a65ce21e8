"""Authenticator, which maps the Authorization field of a request to its agent, and reloads its file after changes."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from rosld.ontology.urls import Space
from rosld.server.auth import config
from rosld.server.auth.config import AuthConfig
from rosld.server.auth.errors import invalid_token
from rosld.server.auth.oidc import Claims, InvalidToken, TokenVerifier, issuer_of, require_library
from rosld.server.auth.permissions import ALLOW_ALL, AboutAt, Permissions, TypesAt
from rosld.server.auth.rules import ANONYMOUS, AUTHENTICATED, Agent
from rosld.server.auth.tokens import parse_credentials
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import file_version

_POLL_SECONDS = 1.0
"""Seconds between checks for changes of the file."""
_MAX_AGENTS = 1000
"""Maximum number of agents whose permissions are cached."""
_log = logging.getLogger("rosld")


class AuthContext(Struct, frozen=True):
    """The permissions of a request's agent, whether they still hold (a stream outlasts them), and the public ones."""

    permissions: Permissions
    is_valid: Callable[[], bool]
    public: Permissions


def _always() -> bool:
    return True


UNRESTRICTED = AuthContext(ALLOW_ALL, _always, ALLOW_ALL)
"""Context of all requests if there is no authentication."""


class Authenticator:
    """Authenticator of one server's requests. Belongs to one loop. Raises ValueError for an invalid file."""

    def __init__(
        self,
        path: Path,
        space: Space,
        types: TypesAt,
        about: AboutAt,
        root: str | None = None,
        make_permissions: Callable[..., Permissions] = Permissions,
    ) -> None:
        """Initialize; the rules are about paths below `root`, by default the base of the space."""
        self._path = path
        self._root = root or space.base
        self._make_permissions = make_permissions
        self._space = space
        self._types = types
        self._about = about
        self._version = file_version(path)
        self.config = self._read()
        if self.config.issuers:
            require_library()
        self.changed = Signal()
        """Signal of possibly changed rights."""
        self._verifier = TokenVerifier()
        self.permissions = lru_cache(maxsize=_MAX_AGENTS)(self._permissions)
        """Returns the current permissions of an agent."""

    @property
    def anonymous(self) -> AuthContext:
        """Context of unauthenticated requests."""
        return self._auth_context(ANONYMOUS, lambda: ANONYMOUS, None)

    async def authenticate(self, field: str | None) -> AuthContext:
        """Return the context of an Authorization field, None for none. Raises a 401 Problem for invalid credentials."""
        if field is None:
            return self.anonymous
        sent = parse_credentials(field)
        if sent is None:
            raise invalid_token("Authorization must be Bearer, or Basic with a token as the password.")
        token = sent.token
        agent = self._holder(token)
        if agent is not None:
            if sent.name not in ("", agent.name):
                raise invalid_token("The token belongs to another agent.")
            return self._auth_context(agent, lambda: self._holder(token), None)
        claims = await self._claims(token)
        if claims is None:
            raise invalid_token("Unknown token.")
        return self._auth_context(self._agent_of(claims), lambda: self._agent_of(claims), claims.expires)

    def _permissions(self, agent: Agent) -> Permissions:
        rights = self.config.policy.rights_of(agent)
        return self._make_permissions(agent, rights, self._space, self._types, self._about)

    def current_permissions(self, agent: Agent) -> Permissions | None:
        """Return the current permissions of an agent that was authenticated before, or None if it no longer is."""
        access = self.config
        name: str | None = agent.name
        if agent == ANONYMOUS:
            return self.permissions(ANONYMOUS)
        for issuer in access.issuers:
            if agent.name.startswith(f"{issuer.url}#"):
                name = access.subjects.get((issuer.url, agent.name.removeprefix(f"{issuer.url}#")))
                if name is None:
                    return self.permissions(agent)
        if name not in {*access.tokens.agents.values(), *access.subjects.values()}:
            return None
        return self.permissions(access.policy.agents[name])

    async def watch_file(self) -> None:
        """Reload the file after each change, until cancelled; an invalid file changes nothing."""
        while True:
            await asyncio.sleep(_POLL_SECONDS)
            await self.reload_if_changed()

    async def reload_if_changed(self) -> None:
        """Reload the file if it has changed."""
        version = await asyncio.to_thread(file_version, self._path)
        if version == self._version:
            return
        self._version = version
        try:
            found = await asyncio.to_thread(self._read)
        except ValueError as error:
            _log.error("%s. The permissions are unchanged.", error)
            return
        self._replace(found)
        _log.info("permissions reloaded from %s", self._path)

    def _read(self) -> AuthConfig:
        """Return the configuration in the file, with rules relative to the base of the space. Raises ValueError."""
        found = config.read_config(self._path, self._root)
        path = tuple(self._space.base[len(self._root) :].split("/")[:-1])
        return replace(found, policy=found.policy.below(path)) if path else found

    def _replace(self, access: AuthConfig) -> None:
        self.config = access
        self.permissions.cache_clear()
        self.changed.emit()

    def _auth_context(self, agent: Agent, now: Callable[[], Agent | None], until: float | None) -> AuthContext:
        permissions, access = self.permissions(agent), self.config

        def still() -> bool:
            if until is not None and time.time() >= until:
                return False
            if self.config is access:
                return True
            found = now()
            return found == agent and self.permissions(found).rights.key == permissions.rights.key

        return AuthContext(permissions, still, self.permissions(ANONYMOUS))

    def _holder(self, token: str) -> Agent | None:
        name = self.config.tokens.owner_of(token)
        return None if name is None else self.config.policy.agents[name]

    async def _claims(self, token: str) -> Claims | None:
        """Return the claims of an issuer's token, or None if it is from no known issuer. Raises a 401 Problem."""
        issuer = issuer_of(token, self.config.issuers)
        if issuer is None:
            return None
        try:
            return await self._verifier.verify(token, issuer)
        except InvalidToken as error:
            raise invalid_token(f"{error}.") from error

    def _agent_of(self, claims: Claims) -> Agent:
        """Return the agent of a subject: the one declared in the file, else one named by issuer and subject."""
        name = self.config.subjects.get((claims.issuer, claims.subject))
        if name is not None:
            return self.config.policy.agents[name]
        if all(issuer.url != claims.issuer for issuer in self.config.issuers):
            return Agent(AUTHENTICATED)
        return Agent(f"{claims.issuer}#{claims.subject}", claims.webid)
