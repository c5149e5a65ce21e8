"""Character encodings by registered name, for reading bodies (RFC 2978, RFC 2781)."""

from __future__ import annotations

import re

UTF_8 = "utf-8"
CHARSETS = ("UTF-8", "US-ASCII", "ISO-8859-1", "windows-1252", "UTF-16")
"""Character encodings of bodies."""

_UTF_16 = "utf-16"
_CODECS = {
    **dict.fromkeys(("utf-8", "utf8"), UTF_8),
    **dict.fromkeys(("us-ascii", "ascii"), "ascii"),
    **dict.fromkeys(("iso-8859-1", "iso8859-1", "iso_8859-1", "latin1", "latin-1"), "latin-1"),
    **dict.fromkeys(("windows-1252", "cp1252"), "cp1252"),
    **{name: name for name in (_UTF_16, "utf-16be", "utf-16le")},
}
_BYTE_ORDER_MARKS = ((b"\xef\xbb\xbf", UTF_8), (b"\xfe\xff", _UTF_16), (b"\xff\xfe", _UTF_16))
_BEGINS_XML = ((b"\x00<\x00?", "utf-16be"), (b"<\x00?\x00", "utf-16le"))
_ENCODING = r"""(<\?xml\s[^>]*?)\sencoding\s*=\s*(?:"([^">]*)"|'([^'>]*)')"""
_DECLARED = re.compile(rb"\s*" + _ENCODING.encode())
_DECLARATION = re.compile(_ENCODING)


class UnknownCharset(ValueError):
    """An unsupported character encoding."""

    def __init__(self, name: str) -> None:
        super().__init__(f"unknown charset {name[:100]!r}; choose from {', '.join(CHARSETS)}")


def codec_of(charset: str) -> str:
    """Return the Python codec of a charset. Raises UnknownCharset."""
    found = _CODECS.get(charset.strip().lower())
    if found is None:
        raise UnknownCharset(charset)
    return found


def decode(data: bytes, codec: str) -> str:
    """Return the text of `data` without a byte order mark; UTF-16 without one is big-endian (RFC 2781 4.3).

    Raises UnicodeDecodeError.
    """
    if codec == _UTF_16 and data[:2] not in (b"\xfe\xff", b"\xff\xfe"):
        codec = "utf-16be"
    return data.decode(codec).removeprefix("\ufeff")


def decode_xml(data: bytes) -> bytes:
    """Return an XML document in UTF-8 without an encoding declaration (encoding detection: XML 1.0 F, RFC 7303 3).

    Raises UnknownCharset, UnicodeDecodeError, and ValueError if the document contradicts its declaration.
    """
    found = next((each for mark, each in (*_BYTE_ORDER_MARKS, *_BEGINS_XML) if data.startswith(mark)), None)
    if found is None:
        declared = _DECLARED.match(data)
        if declared is None:
            return data
        found = codec_of((declared[2] or declared[3] or b"").decode("latin-1"))
        if found.startswith(_UTF_16):
            raise ValueError("the document declares UTF-16 but has one byte per character")
    return strip_encoding_declaration(decode(data, found)).encode()


def strip_encoding_declaration(text: str) -> str:
    """Return a decoded XML document without its encoding declaration."""
    return _DECLARATION.sub(r"\1", text, count=1) if text.lstrip().startswith("<?xml") else text
