"""Redaction of rosld's own access tokens from texts. Pure.

No output of rosld (problem details, receipts, logs, chosen names) contains a token, whatever a client sent.
"""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

PREFIX = "rosld_"
_RANDOM = 43
"""Number of characters after the prefix: 256 random bits, base64url (RFC 4648 5) without padding."""
LENGTH = len(PREFIX) + _RANDOM
"""Number of characters of a token."""
_TOKEN = re.compile(rf"{PREFIX}(?=[\w-]*[A-Z])(?=[\w-]*[a-z])[A-Za-z0-9_-]{{{_RANDOM}}}")
"""Pattern of tokens: all but one in 10^9 have both cases, unlike most ROS names of this length."""
_ENCODED = re.compile("%(?:2[Dd]|3[0-9]|4[1-9A-Fa-f]|5[0-9AaFf]|6[1-9A-Fa-f]|7[0-9Aa])")
"""A percent-encoded character of tokens, which needs no encoding."""
PLACEHOLDER = "rosld-token-withheld"
"""Replacement of a token, valid in URLs."""


def contains_token(text: str) -> bool:
    """Whether a text contains a token of rosld, percent-encoded or not."""
    if PREFIX in text and _TOKEN.search(text):
        return True
    return _ENCODED.search(text) is not None and _TOKEN.search(unquote(text)) is not None


def redact_tokens(text: str) -> str:
    """Replace every token in a text by `PLACEHOLDER`, percent-encoded ones too."""
    if PREFIX in text:
        text = _TOKEN.sub(PLACEHOLDER, text)
    if "%" in text and _TOKEN.search(unquote(text)):
        return quote(_TOKEN.sub(PLACEHOLDER, unquote(text)), safe="/%:@!$&'()*+,;=~?#")
    return text


def redact_tokens_in(value: object) -> object:
    """Replace the tokens in all strings of a JSON value."""
    if isinstance(value, str):
        return redact_tokens(value)
    if isinstance(value, dict):
        return {name: redact_tokens_in(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [redact_tokens_in(each) for each in value]
    return value
