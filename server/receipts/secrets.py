"""Secrets: whether a text looks as if it held credentials. Then it is not written down anywhere. Pure.

Better too often than once too few: what is taken for one costs an excerpt, what is not found is there to be read.
"""

from __future__ import annotations

import re
from urllib.parse import unquote

SCANNED = 2048
"""Characters of a text that are looked through."""
_WORDS = (
    *("passw", "passphr", "passcode", '"pass"', "pass=", "kennwort", "pwd", "secret", "token", "bearer", "credential"),
    *("authori", "authenti", "oauth", "cookie", "csrf", "sessionid", "session_id", "psk", "-----begin "),
)
"""What credentials are called, in small letters: in a name of a field, a path, a parameter of a URL."""
_KEYS = re.compile(r"(?:api|access|private|secret|account|encryption|signing|shared|master|ssh|wifi|wpa)[-_ ]?key")
_WELL_KNOWN = ("ghp_", "gho_", "ghs_", "github_pat_", "glpat-", "xox", "sk-", "sk_live_", "akia", "aiza")
"""What the keys of well-known services begin with."""
_SHAPES: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("key", _KEYS),
    ("basic ", re.compile(r"\bbasic {1,9}[a-z0-9+/=_-]{8}")),  # HTTP authentication
    ("rosld_", re.compile(r"rosld_[\w-]{43}")),  # a token of rosld's own
    ("eyj", re.compile(r"eyj[\w-]{8,200}\.")),  # a JSON Web Token
    ("@", re.compile(r"://[^\s/@:]{0,100}:[^\s/@]{1,200}@")),  # a password in a URL
    *((each, re.compile(rf"\b{each}[\w-]{{10}}")) for each in _WELL_KNOWN),
)
"""What credentials look like, in small letters, each with what all of its kind have: that is looked for first."""
_BARE = re.compile(r"[\s\"']*(?=\S*[0-9])(?=\S*[A-Za-z])[A-Za-z0-9+/_.~=-]{24,1024}[\s\"']*")
"""One word that nobody would say: letters and digits and nothing else."""
_LONGEST_BARE = 1100
_ESCAPED = re.compile(r"\\u([0-9a-fA-F]{4})")


def holds_credentials(text: str) -> bool:
    """Whether a text looks as if it held credentials, also percent-encoded or with the escapes of JSON and Turtle."""
    begin = text[:SCANNED]
    if _looks_so(begin) or (len(begin) < _LONGEST_BARE and _BARE.fullmatch(begin) is not None):
        return True
    if "\\u" in begin:
        begin = _ESCAPED.sub(lambda found: chr(int(found[1], 16)), begin)
        if _looks_so(begin):
            return True
    return "%" in begin and _looks_so(unquote(begin.replace("+", " ")))


def _looks_so(text: str) -> bool:
    small = text.lower()
    for word in _WORDS:
        if word in small:
            return True
    return any(mark in small and shape.search(small) is not None for mark, shape in _SHAPES)
