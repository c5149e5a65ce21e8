"""Safe regular expressions: patterns of clients, matched by RE2, whose time is linear in the text.

RE2 knows no back-references and no lookaround, as XPath knows no lookaround (SHACL 4.4.3, SPARQL 17.4.3.14). `\\d`,
`\\s` and `\\w` are of ASCII, as in Java and in JavaScript, and `$` is the end of the text.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import re2

_STEPS = 30_000_000
"""The size of a pattern times the bytes of a text, up to which it is tried: a third of a second at worst."""
_MAX_PATTERN = 2000
_MAX_MEMORY = 1 << 20
"""Bytes for a pattern: some 40,000 steps of it, which texts of 700 bytes may be tried with."""
_FLAGS = "ims"


@dataclass(frozen=True, slots=True)
class SafePattern:
    """A pattern that may be searched for in texts of up to `max_length` bytes of UTF-8."""

    text: str
    search: Callable[[bytes], object | None]
    max_length: int

    def is_found_in(self, text: str) -> bool:
        """Whether it matches somewhere in a text; a text that is too long to try counts as none."""
        octets = text.encode("utf-8", "surrogatepass")
        return len(octets) <= self.max_length and self.search(octets) is not None


def compile_pattern(text: str, flags: str = "") -> SafePattern:
    """The pattern written as `text`, with SHACL's flags (4.4.3). Raises ValueError for one that cannot be taken."""
    if len(text) > _MAX_PATTERN:
        raise ValueError(f"the pattern {text[:40]!r}... is longer than {_MAX_PATTERN} characters")
    flags = flags.lower()
    if strange := set(flags) - set(_FLAGS):
        raise ValueError(f"the flag {min(strange)!r} of the pattern {text!r} is not known here: use i, m or s")
    options = re2.Options()
    options.max_mem = _MAX_MEMORY
    options.log_errors = False
    try:
        regex = re2.compile((f"(?{flags})" if flags else "").encode() + text.encode("utf-8", "surrogatepass"), options)
    except re2.error as error:
        words = error.args[0].decode("utf-8", "replace") if isinstance(error.args[0], bytes) else str(error)
        raise ValueError(f"the pattern {text[:200]!r} is no regular expression of RE2: {words}") from error
    return SafePattern(text, regex.search, _STEPS // max(1, regex.programsize))
