"""Stateless tokens against cross-site request forgery: they prove that a form is of a page of this server.

A token is bound to the action it was made for and to this run of the server; a foreign page cannot read it. It comes
on top of the Origin rules (`origin.py`), for browsers and extensions that leave the Origin out.
"""

from __future__ import annotations

import hmac
import secrets
from base64 import urlsafe_b64encode
from dataclasses import dataclass, field

from rosld.server.http.problem import Problem

FIELD = "csrf"
"""The name of the hidden form field."""


@dataclass(frozen=True, slots=True)
class FormKey:
    """The secret key of form tokens, another one in each run of the server."""

    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)

    def token(self, action: str) -> str:
        """The token for a form that posts to `action` (a URL)."""
        mac = hmac.digest(self.key, b"form " + action.encode("utf-8", "surrogatepass"), "sha256")
        return urlsafe_b64encode(mac).decode().rstrip("=")

    def is_valid(self, token: str, action: str) -> bool:
        """Whether `token` was made for `action` in this run; takes the same time for any wrong token."""
        return hmac.compare_digest(token.encode("utf-8", "replace"), self.token(action).encode())

    def require(self, token: str | None, action: str) -> None:
        """Raises a 403 Problem unless the token is valid."""
        if token is None or not self.is_valid(token, action):
            raise Problem(403, "This form is not from this run of the server. Load the page again, and send it again.")
