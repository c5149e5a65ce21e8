"""Encoding of literals that pyoxigraph would change, so that the dataset returns every RDF term as it was written.

pyoxigraph stores numbers and times by value: `"7"^^xsd:unsignedByte` is read back as an xsd:integer, `01` as `1`
(https://github.com/oxigraph/oxigraph/issues/526). A literal that would change is stored with a private datatype
instead, which preserves its lexical form and the name of its datatype. The private namespace contains a random number
of this process: nobody else can name it, so each occurrence in an answer stands for an XSD datatype.
"""

from __future__ import annotations

import io
import os
import re
import secrets
from functools import lru_cache
from typing import BinaryIO

import pyoxigraph
from pyoxigraph import Literal, NamedNode, Quad, Triple

from rosld.ontology.vocab import xsd
from rosld.server.dataset.base import Term

VARIABLE = "ROSLD_PRIVATE_NAMESPACE"
"""Environment variable by which the server passes the namespace to the query process."""
NAMESPACE = os.environ.get(VARIABLE) or f"urn:x-{secrets.token_hex(16)}:"
"""Prefix of all private IRIs: plain ASCII, which no syntax escapes."""
NUMERIC = f"{NAMESPACE}n:"
"""Prefix of the private datatypes of numbers."""
INTEGER = f"{NUMERIC}i:"
"""Prefix of the private datatypes of integers, followed by the local name of the XSD datatype."""
DOUBLE = f"{NUMERIC}d:"
"""Prefix of the private datatypes of doubles."""
_OTHER_NUMBER = f"{NUMERIC}n:"
OTHER = f"{NAMESPACE}o:o:"
"""Prefix of the private datatypes of non-numeric datatypes."""
PATTERN = f"{NAMESPACE}[no]:[idno]:"
"""Prefix of any private datatype, as a regular expression."""
_NAMES = (
    "byte short int long unsignedByte unsignedShort unsignedInt unsignedLong "
    "nonNegativeInteger positiveInteger nonPositiveInteger negativeInteger"
)
_INTEGER_TYPES = frozenset(_NAMES.split())
_PREFIXES = {
    **dict.fromkeys((*_INTEGER_TYPES, "integer"), INTEGER),
    "double": DOUBLE,
    **dict.fromkeys(("decimal", "float"), _OTHER_NUMBER),
}
"""Prefixes of private datatypes by the local name of a numeric datatype."""
_COMMON = 9
_REPLACEMENTS = tuple(
    (f'{end}"^^<{xsd.iri}{name}>', f'{end}"^^<{_PREFIXES[name]}{name}>')
    for end, name in ((".0", "double"), *(("", name) for name in _NAMES.split()))
)
"""Texts that always change. Replacement takes a tenth of the time of a regular expression. The last ones are rare."""
_XSD = re.escape(xsd.iri)
_LEXICAL = "[0-9A-Za-z+.: -]+"
"""Lexical forms that pyoxigraph may change."""
_FRACTION = r"-?(?:0|[1-9][0-9]{0,5})\.[0-9]{0,8}[1-9]"
_MOMENT = (
    r"[0-9]{4}-[0-9]{2}-[0-9]{2}T(?!24)[0-9]{2}:[0-9]{2}:[0-9]{2}"
    r"(?:\.[0-9]{0,17}[1-9])?(?:Z|[+-](?!00:00)[0-9]{2}:[0-9]{2})?"
)
_TYPED = re.compile(
    r'>[ \t]*"(?!'
    rf'(?:0|-?[1-9][0-9]{{0,17}})"\^\^<{_XSD}integer>|(?:0|-?[1-9][0-9]{{0,5}}|{_FRACTION})"\^\^<{_XSD}double>'
    rf'|{_MOMENT}"\^\^<{_XSD}dateTime>|(?:true|false)"\^\^<{_XSD}boolean>'
    rf')({_LEXICAL})"\^\^<{_XSD}([A-Za-z]+)>'
)
"""An object of N-Triples that pyoxigraph may change, except for the most frequent that it does not change."""
_LITERAL = re.compile(rf'>[ \t]*"((?:[^"\\]|\\.)*)"\^\^<{_XSD}([A-Za-z]+)>')
_CHANGEABLE = re.compile(_LEXICAL)
_PLAIN = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]*[1-9])?")
_DATE_TIME = re.compile(_MOMENT)
_SPECIAL = frozenset({"INF", "-INF", "NaN", "-0"})
_CACHE_SIZE = 16 * 1024
_BITS = 2.0**26
"""A double that is not an integer when multiplied by this has a unique shortest form, which all programs write."""
_LONGEST_DECIMAL = 18
"""Maximum length of a decimal that is surely within pyoxigraph's range."""
_SHORT = 7
"""Maximum length of a plain number that is not changed: xsd:float holds any six digits."""


def encode_ntriples(text: str) -> str:
    """Return N-Triples with a private datatype for each literal that the dataset would change."""
    if xsd.iri not in text:
        return text
    if r"\"^^<" in text:  # the quote may be within a literal
        return _LITERAL.sub(_encode_match, text)
    for written, stored in _REPLACEMENTS if "Integer>" in text else _REPLACEMENTS[:_COMMON]:
        text = text.replace(written, stored)
    return _TYPED.sub(_encode_match, text)


def decode_ntriples(text: bytes) -> bytes:
    """Return text of any RDF or result syntax with the original datatypes instead of the private ones."""
    return _PRIVATE.sub(_TARGET, text)


_NAMESPACE, _PRIVATE, _TARGET = NAMESPACE.encode(), re.compile(PATTERN.encode()), xsd.iri.encode()


def encode_literal(literal: Literal) -> Literal:
    """Return the literal as it is stored."""
    datatype = literal.datatype.value
    if not datatype.startswith(xsd.iri) or not is_changed(literal.value, name := datatype[len(xsd.iri) :]):
        return literal
    return Literal(literal.value, datatype=private_datatype(name))


def is_numeric(literal: Literal) -> bool:
    """Whether the datatype of a literal is one of XSD's numbers."""
    datatype = literal.datatype.value
    return datatype.startswith(xsd.iri) and datatype[len(xsd.iri) :] in _PREFIXES


def encode_triple(triple: Triple) -> Triple:
    """Return the triple as it is stored."""
    if not isinstance(triple.object, Literal):
        return triple
    return Triple(triple.subject, triple.predicate, encode_literal(triple.object))


def decode_term(term: Term) -> Term:
    """Return the original of a stored term."""
    if isinstance(term, Literal):
        datatype = term.datatype.value
        if datatype.startswith(NAMESPACE):
            return Literal(term.value, datatype=NamedNode(xsd.iri + datatype[len(OTHER) :]))
    return term


def decode_triple(triple: Triple) -> Triple:
    """Return the original of a stored triple."""
    object = decode_term(triple.object)
    return triple if object is triple.object else Triple(triple.subject, triple.predicate, object)


def private_datatype(name: str) -> NamedNode:
    """Return the private datatype of the XSD datatype with this local name."""
    return NamedNode(_PREFIXES.get(name, OTHER) + name)


def is_changed(lexical: str, name: str) -> bool:
    """Whether a literal of the XSD datatype with this local name is stored with a private datatype."""
    if name in _INTEGER_TYPES or (name == "double" and lexical.endswith(".0")):
        return True
    if name == "string" or not _CHANGEABLE.fullmatch(lexical):
        return False
    if name in _PREFIXES:
        return _is_changed_number(lexical, name)
    if name == "dateTime" and _DATE_TIME.fullmatch(lexical):
        return False
    return _is_changed_by_store(lexical, name)


def _is_changed_number(lexical: str, name: str) -> bool:
    """Whether pyoxigraph changes a number or does not accept it (out of range, or malformed)."""
    if not _PLAIN.fullmatch(lexical) or lexical == "-0":
        return lexical not in _SPECIAL or name in ("integer", "decimal")
    if name == "integer":
        return "." in lexical or not -(2**63) <= int(lexical[:20]) < 2**63
    if name == "decimal":
        return len(lexical) > _LONGEST_DECIMAL
    if name == "double" and not ((value := float(lexical)) * _BITS).is_integer():
        written = repr(value)
        if "e" not in written:
            return written != lexical
    return len(lexical) > _SHORT and _is_changed_by_store(lexical, name)


@lru_cache(maxsize=_CACHE_SIZE)
def _is_changed_by_store(lexical: str, name: str) -> bool:
    """Whether pyoxigraph itself changes a literal."""
    literal = Literal(lexical, datatype=NamedNode(xsd.iri + name))
    store = pyoxigraph.Store()
    store.add(Quad(literal.datatype, literal.datatype, literal))
    [quad] = store
    return bool(quad.object != literal)


def _encode_match(match: re.Match[str]) -> str:
    lexical, name = match.groups()
    if is_changed(lexical, name):
        return f'> "{lexical}"^^<{_PREFIXES.get(name, OTHER)}{name}>'
    return match[0]


class Decoder(io.RawIOBase):
    """Output stream that decodes what is written; `finish` writes the rest, held back as possibly incomplete."""

    def __init__(self, output: BinaryIO) -> None:
        super().__init__()
        self._output = output
        self._rest = b""

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Write bytes. Raises what the output raises."""
        text = self._rest + bytes(data)
        border = _safe_length(text)
        self._rest = text[border:]
        if border:
            self._output.write(decode_ntriples(text[:border]))
        return len(data)

    def finish(self) -> None:
        """Write the rest. Raises what the output raises."""
        rest, self._rest = self._rest, b""
        if rest:
            self._output.write(decode_ntriples(rest))


def _safe_length(text: bytes) -> int:
    """Return the start of a possibly incomplete private datatype at the end of the text, or the text's length."""
    start = max(0, len(text) - len(OTHER) + 1)
    while (start := text.find(_NAMESPACE[:1], start)) >= 0:
        if _NAMESPACE.startswith(text[start : start + len(_NAMESPACE)]):
            return start
        start += 1
    return len(text)
