"""Labels: the words a page uses for predicates, fields and kinds."""

from __future__ import annotations

import re
from functools import lru_cache

_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_WORDS = {
    "contains": "contains",
    "comment": "about",
    "md5": "MD5",
    "typeHash": "type hash",
    "uri": "URI",
    "isDefinedBy": "defined by",
    "subClassOf": "is a kind of",
    "subPropertyOf": "is a kind of",
    "seeAlso": "see also",
}


@lru_cache(maxsize=4096)
def local_name(iri: str) -> str:
    """What follows the last `#`, `/` or `:` of an IRI that is not its end."""
    return re.split(r"[#/:]", iri.rstrip("#/:"))[-1] or iri


@lru_cache(maxsize=4096)
def label(iri: str) -> str:
    """The words for a predicate: `hasMessageType` is "message type"."""
    name = local_name(iri)
    return _WORDS.get(name) or split_words(name).removeprefix("has ")


def split_words(name: str) -> str:
    """`messageType` and `message_type` as "message type"; abbreviations in capitals stay as they are."""
    parts = _HUMP.sub(" ", name.replace("_", " ")).split()
    return " ".join(part if part.isupper() else part.lower() for part in parts) or name


def capitalize(text: str) -> str:
    """`text` with a capital at its beginning."""
    return text[:1].upper() + text[1:]
