"""Names of new members, from a Slug header where there is one (LDP 5.2.3.10, RFC 5023 9.7)."""

from __future__ import annotations

import re
import secrets
import unicodedata
from collections.abc import Callable, Iterator
from urllib.parse import unquote_to_bytes

from rosld.server.http.token_redaction import redact_tokens

MAX_LENGTH = 100
"""Characters of a name."""
_COUNTED = range(2, 10)
"""The numbers that are tried before chance: looking through all the names of a large container would take its time."""
_SOUNDS = tuple(consonant + vowel for consonant in "bdfghjklmnprstvz" for vowel in "aeiou")
_RESERVED = re.compile(r"\.meta$", re.IGNORECASE)
_SUFFIX = re.compile(r"(?:\.[0-9A-Za-z]{1,15})?")
_READ = MAX_LENGTH * 12
"""Characters of a Slug that are read: each of a name's may be four bytes, each percent-encoded."""
_INVISIBLE = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0") | {
    chr(code) for span in (range(0x180B, 0x1810), range(0xFE00, 0xFE10), range(0xE0100, 0xE01F0)) for code in span
}
"""Letters and marks that nobody sees (Unicode's Default_Ignorable_Code_Point): two names would look the same."""


def choose_name(slug: str | None, taken: Callable[[str], bool], *, suffix: str = "") -> str:
    """A name for a new member, not yet percent-encoded: readable, one segment of a path, and nobody's before.

    Letters, marks, digits, `-`, `_` and `.` of the Slug are kept, everything else becomes `-`; without a Slug, or where
    nothing of it remains, the name is made of sounds. In NFC, at most 100 characters, it begins with a letter, a digit
    or `_`, and does not end in a dot or in `.meta`. `taken` says of a name whether it is there or ever was (LDP
    5.2.3.11); then numbers and at last chance are added. `suffix`, such as `.png`, is what a name without an extension
    of its own ends in; raises ValueError for one that is no extension.
    """
    if not _SUFFIX.fullmatch(suffix) or _RESERVED.search(suffix):
        raise ValueError(f"{suffix!r} is no extension such as '.png'")
    stem, extension = _split(_readable(redact_tokens(slug or "")), suffix)
    return next(name for name in _candidates(stem or _word(), extension) if not taken(name))


def _candidates(stem: str, extension: str) -> Iterator[str]:
    yield _join(stem, "", extension)
    for number in _COUNTED:
        yield _join(stem, f"-{number}", extension)
    while True:
        yield _join(stem, f"-{secrets.token_hex(4)}", extension)


def _join(stem: str, added: str, extension: str) -> str:
    """A name of all three, the stem cut short where it is too long; what was cut may have ended well before."""
    kept = stem[: MAX_LENGTH - len(added) - len(extension)].rstrip("-.")
    return unicodedata.normalize("NFC", kept + added + extension)


def _readable(slug: str) -> str:
    """What remains of a Slug: empty where nothing does."""
    text = unicodedata.normalize("NFC", _decode(slug))
    kept = "".join(char if _is_kept(char) else "-" for char in text if char not in _INVISIBLE)
    name = re.sub(r"-{2,}", "-", kept)
    name = re.sub(r"\.{2,}", ".", name)
    while name and (name[0] in "-." or unicodedata.category(name[0])[0] == "M"):
        name = name[1:]
    name = unicodedata.normalize("NFC", name)[:MAX_LENGTH].rstrip("-.")
    return _RESERVED.sub("-meta", name)


def _decode(slug: str) -> str:
    """The text of a Slug (RFC 5023 9.7.1): its octets percent-decoded, then read as UTF-8."""
    raw = slug[:_READ].encode("latin-1", "ignore") if _is_latin(slug) else slug[:_READ].encode("utf-8", "ignore")
    return unquote_to_bytes(raw).decode("utf-8", "replace")


def _is_latin(text: str) -> bool:
    """Whether these are the octets of a header field, as they come from the web."""
    return all(char <= "\xff" for char in text)


def _is_kept(char: str) -> bool:
    return char in "-_." or unicodedata.category(char)[0] in "LMN"


def _split(name: str, suffix: str) -> tuple[str, str]:
    """A name without its extension, and the extension; `suffix` for a name that has none."""
    stem, dot, last = name.rpartition(".")
    if dot and stem and re.fullmatch(r"[0-9A-Za-z]{1,15}", last):
        return stem, dot + last
    return name, suffix


def _word() -> str:
    """A name by chance that can be read aloud: two words of three sounds, of 5 * 10^11 such names."""
    number, sounds = secrets.randbelow(len(_SOUNDS) ** 6), []
    for _ in range(6):
        number, sound = divmod(number, len(_SOUNDS))
        sounds.append(_SOUNDS[sound])
    return "".join(sounds[:3]) + "-" + "".join(sounds[3:])
