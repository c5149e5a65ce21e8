"""Access tokens of OpenID Connect issuers, checked with a small real issuer on loopback."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import jwt
import pytest
from cryptography.hazmat.primitives import serialization

from tests.server.auth.conftest import Guarded, rule
from tests.server.auth.issuer import Issuer

AGENTS = """[[issuer]]
url = "{url}"
audience = "robot"

[[agent]]
name = "anna"
issuer = "{url}"
subject = "anna-1"

"""
RULES = AGENTS + rule("anna", "read", "/topics/**") + rule("authenticated", "read", "/")


@pytest.fixture(scope="module")
def guarded(guard: Callable[..., Guarded], issuer: Issuer) -> Guarded:
    return guard(RULES.format(url=issuer.url))


def status(guarded: Guarded, token: str, path: str = "/topics/") -> int:
    return guarded["anybody"].get(path, headers={"Authorization": f"Bearer {token}"}).status_code


def test_a_token_of_an_issuer_that_counts_is_its_subject(guarded: Guarded, issuer: Issuer) -> None:
    assert status(guarded, issuer.token()) == 200
    assert status(guarded, issuer.token(kid=None)) == 200
    assert status(guarded, issuer.token(), "/nodes/") == 404


def test_subjects_that_the_file_does_not_name_are_known_and_no_more(guarded: Guarded, issuer: Issuer) -> None:
    assert status(guarded, issuer.token(sub="bert"), "/") == 200
    assert status(guarded, issuer.token(sub="bert")) == 404


def test_what_does_not_hold_is_refused(guarded: Guarded, issuer: Issuer) -> None:
    public = issuer.key.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )
    head, body, signature = issuer.token().split(".")
    wrong = {
        "expired": issuer.token(exp=time.time() - 60),
        "without an end": issuer.token(exp=None),
        "for others": issuer.token(aud="other"),
        "for nobody": issuer.token(aud=None),
        "of nobody": issuer.token(sub=None),
        "of another issuer": issuer.token(iss="https://evil.example"),
        "by another key": issuer.token(key=issuer.other),
        "by a key that is not known": issuer.token(kid="two"),
        "unsigned": jwt.encode(
            {"iss": issuer.url, "aud": "robot", "sub": "anna-1", "exp": time.time() + 60}, "", "none"
        ),
        "by the public key as a secret": _forged(public, issuer),
        "by the shared secret": issuer.token(key=b"\0" * 32, algorithm="HS256", kid="s"),
        "changed": ".".join((head, body[:-2] + ("AA" if body[-2:] != "AA" else "BB"), signature)),
        "not yet": issuer.token(nbf=time.time() + 600),
    }
    assert {why: status(guarded, token) for why, token in wrong.items()} == dict.fromkeys(wrong, 401)


def _forged(public: bytes, issuer: Issuer) -> str:
    """Return a token with RS256's public key as the secret of HS256; assembled here, as the library refuses to."""
    import base64
    import hashlib
    import hmac

    def encoded(part: object) -> bytes:
        return base64.urlsafe_b64encode(json.dumps(part).encode()).rstrip(b"=")

    claims = {"iss": issuer.url, "aud": "robot", "sub": "anna-1", "exp": time.time() + 60}
    signed = encoded({"alg": "HS256", "kid": "one"}) + b"." + encoded(claims)
    mac = base64.urlsafe_b64encode(hmac.digest(public, signed, hashlib.sha256)).rstrip(b"=")
    return (signed + b"." + mac).decode()


def test_keys_are_kept_and_not_fetched_for_every_token_with_a_key_of_its_own(guarded: Guarded, issuer: Issuer) -> None:
    before = issuer.fetched
    for number in range(20):
        assert status(guarded, issuer.token(kid=f"made-up-{number}")) == 401
    assert issuer.fetched - before <= 1
