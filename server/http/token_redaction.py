"""Redaction of rosld's own access tokens from texts. Pure.

What rosld says itself (problem details, receipts, logs, names it gives) has no token in it, whatever a client sent.
"""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

PREFIX = "rosld_"
_RANDOM = 43
"""Characters after the prefix: 256 random bits, base64url (RFC 4648 5) without padding."""
LENGTH = len(PREFIX) + _RANDOM
"""Characters of a token."""
_TOKEN = re.compile(rf"{PREFIX}(?=[\w-]*[A-Z])(?=[\w-]*[a-z])[A-Za-z0-9_-]{{{_RANDOM}}}")
"""Both cases occur in every token but one in 10^9, and hardly in a name of ROS that is as long."""
_ENCODED = re.compile("%(?:2[Dd]|3[0-9]|4[1-9A-Fa-f]|5[0-9AaFf]|6[1-9A-Fa-f]|7[0-9Aa])")
"""A character that tokens consist of, percent-encoded, which nobody does without need."""
PLACEHOLDER = "rosld-token-withheld"
"""What stands in place of a token; fit for URLs."""


def contains_token(text: str) -> bool:
    """Whether a text holds a token of rosld, percent-encoded or not."""
    if PREFIX in text and _TOKEN.search(text):
        return True
    return _ENCODED.search(text) is not None and _TOKEN.search(unquote(text)) is not None


def redact_tokens(text: str) -> str:
    """Return the text with `PLACEHOLDER` in place of every token, percent-encoded ones too."""
    if PREFIX in text:
        text = _TOKEN.sub(PLACEHOLDER, text)
    if "%" in text and _TOKEN.search(unquote(text)):
        return quote(_TOKEN.sub(PLACEHOLDER, unquote(text)), safe="/%:@!$&'()*+,;=~?#")
    return text


def redact_tokens_in(value: object) -> object:
    """Return the same of every string in a JSON value; other values are as they are."""
    if isinstance(value, str):
        return redact_tokens(value)
    if isinstance(value, dict):
        return {name: redact_tokens_in(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [redact_tokens_in(each) for each in value]
    return value
