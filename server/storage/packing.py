"""Large N-Triples, packed: what a record says is kept compressed from a size on, so that the loop handles little of it.

A million triples of one kind are some hundred megabytes of N-Triples, and three packed. What is small stays as it is,
byte for byte. Packing and unpacking what is large take a second or so: worker processes do that.
"""

from __future__ import annotations

import struct
import zlib

from rosld.server.storage.record import Record

LARGE_BYTES = 256 * 1024
"""Bytes of N-Triples from which they are packed: some 2,500 triples, which a parser takes 5 ms for."""
MAX_BYTES = 2 * 1024 * 1024 * 1024
"""Bytes of N-Triples that may be packed at the most."""
_MARK = b"\x00z1"
"""What packed bytes begin with, and N-Triples never do."""
_HEAD = struct.Struct("<3sQ")
_LEVEL = 1
"""The quickest: lines of N-Triples are much alike."""


def pack(ntriples: bytes) -> bytes:
    """N-Triples as they are kept: packed where they are large."""
    if len(ntriples) < LARGE_BYTES:
        return ntriples
    return _HEAD.pack(_MARK, len(ntriples)) + zlib.compress(ntriples, _LEVEL)


def unpack(kept: bytes) -> bytes:
    """The N-Triples that are kept so."""
    return zlib.decompress(memoryview(kept)[_HEAD.size :], bufsize=size_of(kept)) if is_packed(kept) else kept


def unpack_prefix(kept: bytes, size: int) -> bytes:
    """The first `size` bytes of the N-Triples that are kept so, whose rest is not unpacked."""
    if not is_packed(kept):
        return kept[:size]
    return zlib.decompressobj().decompress(memoryview(kept)[_HEAD.size :], size)


def is_packed(kept: bytes) -> bool:
    """Whether N-Triples are kept packed, being large."""
    return kept[: len(_MARK)] == _MARK


def size_of(kept: bytes) -> int:
    """The bytes of the N-Triples that are kept so."""
    return int(_HEAD.unpack_from(kept)[1]) if is_packed(kept) else len(kept)


def is_large(record: Record) -> bool:
    """Whether what a record says is too much to be worked on by the loop."""
    return is_packed(record.triples) or len(record.triples) >= LARGE_BYTES
