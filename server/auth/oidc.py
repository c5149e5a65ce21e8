"""OpenID Connect: access tokens of issuers, verified with the issuers' keys by PyJWT (the extra `oidc`).

Verified are the signature (with an algorithm that the file lists, never `none` or a shared secret), the issuer, the
audience, and the times. Keys are fetched only from the issuer, in a thread, within limits of time and size, and cached.
"""

from __future__ import annotations

import asyncio
import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterable, Mapping
from typing import NamedTuple
from urllib.parse import urlsplit

from msgspec import Struct, field

from rosld.server.auth.config import Issuer

_SECONDS = 5.0
_MAX_BYTES = 256 * 1024
_CACHED_SECONDS = 3600.0
_REFETCH_SECONDS = 10.0
"""Minimum seconds between two fetches of an issuer's keys, even for a token with an unknown key."""
_LEEWAY = 10.0
_LONGEST_TOKEN = 16 * 1024


class InvalidToken(Exception):
    """A token is rejected; the message is for the sender, and reveals nothing about keys."""


class Claims(NamedTuple):
    """The claims of an accepted token; `expires` in seconds of the epoch."""

    issuer: str
    subject: str
    expires: float
    webid: str | None = None


class _Keys(NamedTuple):
    """Keys of an issuer by their ids, and the time of their retrieval (monotonic, s)."""

    by_id: Mapping[str, object]
    fetched: float


def issuer_of(token: str, issuers: Iterable[Issuer]) -> Issuer | None:
    """Return the issuer that a token claims if it is trusted, else None."""
    if not issuers or token.count(".") != 2 or len(token) > _LONGEST_TOKEN:
        return None
    try:
        import jwt
    except ImportError:
        return None
    try:
        claimed = jwt.decode(token, options={"verify_signature": False}).get("iss")
    except jwt.PyJWTError:
        return None
    return next((issuer for issuer in issuers if issuer.url == claimed), None)


class TokenVerifier(Struct):
    """Verifier of tokens. Belongs to one loop."""

    _keys: dict[Issuer, _Keys] = field(default_factory=dict)
    _fetching: dict[Issuer, asyncio.Lock] = field(default_factory=dict)

    async def verify(self, token: str, issuer: Issuer) -> Claims:
        """Return the claims of a token. Raises InvalidToken for a rejected one."""
        import jwt

        try:
            key_id = jwt.get_unverified_header(token).get("kid")
        except jwt.PyJWTError as error:
            raise InvalidToken("The token is malformed") from error
        key = await self._key(issuer, key_id)
        try:
            claims = jwt.decode(
                token,
                key,  # type: ignore[arg-type]
                algorithms=list(issuer.algorithms),
                audience=issuer.audience,
                issuer=issuer.url,
                leeway=_LEEWAY,
                options={"require": ["exp", "iss", "aud", "sub"], "verify_signature": True},
            )
        except jwt.ExpiredSignatureError as error:
            raise InvalidToken("The token has expired") from error
        except (jwt.PyJWTError, ValueError, TypeError) as error:
            raise InvalidToken("The token is invalid") from error
        webid = claims.get("webid")
        return Claims(issuer.url, str(claims["sub"]), float(claims["exp"]), webid if isinstance(webid, str) else None)

    async def _key(self, issuer: Issuer, key_id: object) -> object:
        """Return the key with an id; a token without a key id gets the issuer's only key."""
        lock = self._fetching.setdefault(issuer, asyncio.Lock())
        async with lock:
            known = self._keys.get(issuer)
            now = time.monotonic()
            age = float("inf") if known is None else now - known.fetched
            if known is None or age > _CACHED_SECONDS or (_find_key(known, key_id) is None and age > _REFETCH_SECONDS):
                try:
                    known = _Keys(await asyncio.to_thread(_fetch, issuer), now)
                except (OSError, ValueError) as error:
                    if known is None:
                        raise InvalidToken("The issuer's keys are currently unavailable") from error
                self._keys[issuer] = known
        found = _find_key(known, key_id)
        if found is None:
            raise InvalidToken("The issuer has no such key")
        return found


def _find_key(keys: _Keys, key_id: object) -> object | None:
    if key_id is None and len(keys.by_id) == 1:
        return next(iter(keys.by_id.values()))
    return keys.by_id.get(key_id) if isinstance(key_id, str) else None


def _fetch(issuer: Issuer) -> Mapping[str, object]:
    """Return the keys of an issuer by their ids (blocking). Raises OSError and ValueError."""
    import jwt

    found: dict[str, object] = {}
    keys = _json(issuer.keys or _keys_url(issuer)).get("keys")
    for number, each in enumerate(keys if isinstance(keys, list) else ()):
        if not isinstance(each, dict) or each.get("kty") == "oct" or each.get("use", "sig") != "sig":
            continue
        try:
            found[str(each.get("kid", number))] = jwt.PyJWK(each)
        except (jwt.PyJWTError, ValueError, TypeError):
            continue
    return found


def _keys_url(issuer: Issuer) -> str:
    """Return the URL of an issuer's keys (OpenID Connect Discovery 4). Raises OSError and ValueError."""
    url = _json(f"{issuer.url.rstrip('/')}/.well-known/openid-configuration").get("jwks_uri")
    if not isinstance(url, str) or not _is_safe(url, issuer.url):
        raise ValueError("the issuer's configuration has no keys")
    return url


def _is_safe(url: str, issuer: str) -> bool:
    """Whether keys may be fetched from a URL: by https, or from the scheme and host of the issuer."""
    return urlsplit(url).scheme == "https" or urlsplit(url)[:2] == urlsplit(issuer)[:2]


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """A handler that follows no redirect."""

    def redirect_request(self, *_: object) -> None:
        return None


def _json(url: str) -> dict[str, object]:
    """Return the JSON object at a URL without following redirects."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), _NoRedirects())
    try:
        with opener.open(
            urllib.request.Request(url, headers={"Accept": "application/json"}), timeout=_SECONDS
        ) as answer:
            data = answer.read(_MAX_BYTES + 1)
    except urllib.error.HTTPError as error:
        error.close()
        raise
    if len(data) > _MAX_BYTES:
        raise ValueError(f"the response of {url} is larger than {_MAX_BYTES} bytes")
    found = json.loads(data)
    if not isinstance(found, dict):
        raise ValueError(f"{url} is not a JSON object")
    return found


def require_library() -> None:
    """Raise ValueError if issuers are configured but PyJWT is missing."""
    try:
        import jwt  # noqa: F401
    except ImportError:
        raise ValueError("verifying tokens of issuers needs PyJWT: pip install 'rosld[oidc]'") from None
