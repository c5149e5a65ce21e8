"""The charset of a body (RFC 9110 8.3.2): text is read in the one that its Content-Type states."""

from __future__ import annotations

from rosld.ontology.charsets import UTF_8, UnknownCharset, codec_of, decode, strip_encoding_declaration
from rosld.server.http.media import MediaType
from rosld.server.http.problem import Problem

FORM = "application/x-www-form-urlencoded"


def codec_for(media_type: MediaType) -> str:
    """The Python codec of the charset that a media type states, UTF-8 where it states none.

    The parts of a multipart body each state their own, and what is said of the whole means nothing. A form is ASCII
    with percent-encoded octets, which no UTF-16 has. Raises a 415 Problem for a charset that is not read here.
    """
    stated = media_type.parameter("charset")
    if stated is None or media_type.type == "multipart":
        return UTF_8
    try:
        found = codec_of(stated)
    except UnknownCharset as error:
        raise Problem(415, f"Content-Type: {media_type}: {error}.") from error
    if found.startswith("utf-16") and media_type.essence == FORM:
        raise Problem(415, f"Content-Type: {media_type}: a form is in a charset that has ASCII in it, such as UTF-8.")
    return found


def to_utf8(data: bytes, media_type: MediaType) -> bytes:
    """A body in UTF-8. Raises Problems: 415 as `codec_of`, 400 for bytes that are nothing in the stated charset."""
    stated = media_type.parameter("charset")
    if stated is None:
        return data
    found, declares_another = codec_for(media_type), _is_xml(media_type)  # what the field says counts (RFC 7303 3.2)
    if not data or (found == UTF_8 and not declares_another):
        return data
    try:
        text = decode(data, found)
    except UnicodeDecodeError as error:
        raise Problem(400, f"The body is not in {stated}, as it says: {error.reason} at byte {error.start}.") from error
    return (strip_encoding_declaration(text) if declares_another else text).encode()


def _is_xml(media_type: MediaType) -> bool:
    return media_type.subtype == "xml" or media_type.subtype.endswith("+xml")
