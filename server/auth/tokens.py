"""Bearer tokens (RFC 6750): generated, shown once, stored as digests, and recognised. Pure except for generation.

A token is 256 random bits, so its digest needs no salt. The agent is looked up by the digest of the received token, so
that no comparison reveals how much of a token was right.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping
from functools import cached_property

from msgspec import Struct

from rosld.server.http.token_redaction import PREFIX

DIGEST = re.compile(r"sha256:[0-9a-f]{64}")
_TOKEN68 = re.compile(r"[A-Za-z0-9\-._~+/]+=*")
_MAX_FIELD = 16 * 1024


def generate_token() -> str:
    """Return a new token."""
    return PREFIX + secrets.token_urlsafe(32)


def token_digest(token: str) -> str:
    """Return the stored digest of a token."""
    return "sha256:" + hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


class TokenTable(Struct, frozen=True, dict=True):
    """Names of agents by the digests of their tokens."""

    agents: Mapping[str, str]

    @cached_property
    def _by_digest(self) -> Mapping[str, tuple[str, str]]:
        return {known: (known, name) for known, name in self.agents.items()}

    def owner_of(self, token: str) -> str | None:
        """Return the name of the agent with this token, or None."""
        sent = token_digest(token)
        known, found = self._by_digest.get(sent, ("", None))
        return found if hmac.compare_digest(sent, known) else None


class Credentials(Struct, frozen=True):
    """Credentials of a request: a token, and the user name if the token was sent as a password."""

    token: str
    name: str = ""


def parse_credentials(field: str) -> Credentials | None:
    """Return the token in an Authorization field (RFC 9110 11.6.2), or None.

    Accepted are Bearer, and Basic with the token as its password (RFC 7617).
    """
    scheme, _, rest = field.strip(" \t").partition(" ")
    rest = rest.strip(" \t")
    if len(rest) > _MAX_FIELD or not _TOKEN68.fullmatch(rest):
        return None
    if scheme.lower() == "bearer":
        return Credentials(rest)
    if scheme.lower() != "basic":
        return None
    try:
        name, colon, password = base64.b64decode(rest, validate=True).decode("utf-8").partition(":")
    except (binascii.Error, ValueError):
        return None
    return Credentials(password, name) if colon else None
