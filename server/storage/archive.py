"""Archive of all records and their blobs: one compressed tar file, readable by people and by other programs.

    rosld.json      the format, and the base URL that the records belong to
    records.jsonl   one record per line, containers before their members
    gone.jsonl      the paths of removed records, one per line
    blobs/ID        the bytes of the non-RDF sources

`pack` writes a consistent snapshot, even while a server writes; `ArchiveReader` checks everything that it reads.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import re
import shutil
import sqlite3
import tarfile
import tempfile
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, NamedTuple, cast

import pyoxigraph
from msgspec.structs import asdict, replace

from rosld.server.storage.blobs import ID, Blobs
from rosld.server.storage.record import (
    NO_MEMBER,
    Blob,
    Membership,
    Model,
    Put,
    Record,
    check_write,
    container_of,
    database_error,
)
from rosld.server.storage.record_documents import pack_triples, unpack_triples
from rosld.server.storage.record_table import NumberedRecord, RecordTable
from rosld.server.storage.sqlite import BLOBS, DATABASE, connect

FORMAT = 1
_ABOUT, _RECORDS, _TOMBSTONES = "rosld.json", "records.jsonl", "gone.jsonl"
_COMPRESSION = 4
_SMALL = 64 * 1024
_MAX_NUMBER = 1 << 62
_PATH = re.compile(r"(?:[A-Za-z0-9._~!$&'()*+,;=:@/-]|%[0-9A-Fa-f]{2})+")
_IRI = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:[^\x00-\x20<>\"{}|\\^`]*")
_MEDIA_TYPE = re.compile(r"[\x20-\x7e]{1,1000}")


class ArchiveCounts(NamedTuple):
    """Numbers of records and blobs in an archive."""

    records: int
    blobs: int


def pack(folder: Path, file: IO[bytes], base: str) -> ArchiveCounts:
    """Write the records of a folder, which a server may be using. Raises ValueError, OSError, StorageError."""
    if not (folder / DATABASE).is_file():
        raise ValueError(f"{folder} holds no records ({DATABASE} is missing)")
    blobs = Blobs(folder / BLOBS, durable=True)
    with (
        contextlib.closing(blobs),
        blobs.hold_files(),
        tempfile.TemporaryFile() as records,
        tempfile.TemporaryFile() as tombstones,
    ):
        ids = list[str]()
        count = 0
        for entry in _snapshot(folder, tombstones):
            count += 1
            records.write(_line(_entry_json(entry)))
            if entry.record.blob is not None:
                ids.append(entry.record.blob.id)
        about = {"format": FORMAT, "base": base, "records": count, "blobs": len(ids)}
        # Without times and host names, so that the same records give the same bytes.
        with (
            gzip.GzipFile("", "wb", _COMPRESSION, file, mtime=0) as compressed,
            tarfile.open(fileobj=cast("IO[bytes]", compressed), mode="w|", format=tarfile.PAX_FORMAT) as tar,
        ):
            _add(tar, _ABOUT, io.BytesIO(_line(about)))
            _add(tar, _RECORDS, records)
            _add(tar, _TOMBSTONES, tombstones)
            for id in ids:
                with blobs.path(id).open("rb") as blob:
                    _add(tar, f"blobs/{id}", blob)
    return ArchiveCounts(count, len(ids))


def _snapshot(folder: Path, tombstones: IO[bytes]) -> Iterator[NumberedRecord]:
    """Yield all entries from one snapshot; at the end write the paths of the removed records to `tombstones`."""
    try:
        with contextlib.closing(connect(folder)) as connection:
            table = RecordTable(connection)
            connection.execute("BEGIN")
            yield from table.all_records()
            for path in table.tombstones():
                tombstones.write(_line(path))
            connection.execute("ROLLBACK")
    except sqlite3.Error as error:
        raise database_error(error) from error


class ArchiveReader:
    """Reader of an archive: `base` is available at once, and `restore_into` restores the records."""

    def __init__(self, file: IO[bytes]) -> None:
        """Raise ValueError if the file is not an archive of this format."""
        with _archive_errors():
            self._file = gzip.GzipFile(fileobj=file, mode="rb")
            self._tar = tarfile.open(  # noqa: SIM115 - open as long as the reader exists
                fileobj=cast("IO[bytes]", self._file), mode="r|"
            )
            about = json.loads(self._member(_ABOUT).read(_SMALL))
            if not isinstance(about, dict) or not isinstance(about.get("base"), str):
                raise ValueError(f"{_ABOUT} does not contain a base")
        if about.get("format") != FORMAT:
            raise ValueError(
                f"the dump has format {about.get('format')}, but this rosld supports {FORMAT}: use a newer rosld"
            )
        self.base: str = about["base"]
        """The base URL that the records belong to."""

    def restore_into(self, folder: Path, base: str) -> tuple[ArchiveCounts, list[str]]:
        """Replace all records of a folder with those of the archive, in one transaction.

        If `base` differs from the archive's, every IRI is rewritten. A server may be using the folder: it notices the
        change. Returns the ids of the blobs that are no longer referenced, to be removed once nobody reads them. Raises
        ValueError if the archive is damaged, and OSError or StorageError if it cannot be stored; then nothing has
        changed.
        """
        blobs = Blobs(folder / BLOBS, durable=True)
        new = dict[str, str]()
        with (
            contextlib.closing(blobs),
            blobs.hold_files(),
            contextlib.closing(connect(folder)) as connection,
            tempfile.TemporaryFile() as records,
        ):
            try:
                with _archive_errors():
                    count, sizes, tombstones = self._check_records(records)
                    self._blobs(sizes, new, blobs)
                    relocation = _Relocation(self.base, base, new)
                    freed = _replace_all(connection, (relocation.entry(_entry(line)) for line in records), tombstones)
            except BaseException:
                for id in new.values():
                    blobs.discard(id)
                raise
        return ArchiveCounts(count, len(new)), freed

    def _check_records(self, records: IO[bytes]) -> tuple[int, dict[str, int], list[str]]:
        """Copy and check records; return their number, sizes of blobs by id, and removed paths."""
        shutil.copyfileobj(self._member(_RECORDS), records)
        records.seek(0)
        count, sizes = 0, dict[str, int]()
        for line in records:
            _check(_entry(line).record, sizes)
            count += 1
        records.seek(0)
        return count, sizes, [_path(json.loads(line)) for line in self._member(_TOMBSTONES)]

    def _member(self, name: str) -> IO[bytes]:
        """Return the next member of the archive, which must have this name."""
        member = self._tar.next()
        file = self._tar.extractfile(member) if member is not None and member.name == name and member.isreg() else None
        if file is None:
            raise ValueError(f"{name} is missing or out of order")
        return file

    def _blobs(self, sizes: Mapping[str, int], new: dict[str, str], blobs: Blobs) -> None:
        """Store every blob under a new id, and add it to `new`, by its old id."""
        for id, size in sizes.items():
            file = self._member(f"blobs/{id}")
            new[id] = blobs.add(file, size)
        if self._tar.next() is not None:
            raise ValueError("there is data after its last file")
        while self._file.read(_SMALL):  # read to the end, where the checksum is
            pass
        blobs.sync()


class _Relocation:
    """Rewrites the blob ids of entries, and their IRIs if the base URL differs."""

    def __init__(self, old: str, new: str, blobs: Mapping[str, str]) -> None:
        self._blobs = blobs
        self._old, self._new = old, new
        self._token = re.compile(rb'"(?:[^"\\]|\\.)*"|<' + re.escape(old.encode()))

    def entry(self, entry: NumberedRecord) -> NumberedRecord:
        record, blob = entry.record, entry.record.blob
        if blob is not None:
            record = replace(record, blob=replace(blob, id=self._blobs[blob.id]))
        return NumberedRecord(entry.number, record if self._old == self._new else self._rewritten(record))

    def _rewritten(self, record: Record) -> Record:
        membership = record.membership
        if membership is not None:
            membership = Membership(
                self._iri(membership.resource),
                self._iri(membership.relation),
                membership.inverse,
                membership.content and self._iri(membership.content),
            )
        begins = b"<" + self._new.encode()
        ntriples = unpack_triples(record.triples)
        triples = pack_triples(self._token.sub(lambda match: begins if match[0][:1] == b"<" else match[0], ntriples))
        member = record.member and self._iri(record.member)
        return replace(record, triples=triples, member=member, membership=membership)

    def _iri(self, iri: str) -> str:
        return self._new + iri[len(self._old) :] if iri.startswith(self._old) else iri


def _replace_all(
    connection: sqlite3.Connection, entries: Iterable[NumberedRecord], tombstones: Iterable[str]
) -> list[str]:
    """Replace all records with these entries; return the ids of the blobs that are no longer referenced."""
    table = RecordTable(connection)
    try:
        table.begin()
        freed = table.restore(entries, tombstones, time.time_ns())
        table.commit()
    except sqlite3.Error as error:
        raise database_error(error) from error
    finally:
        table.rollback()
    return freed


def _entry_json(entry: NumberedRecord) -> dict[str, object]:
    record = entry.record
    members: dict[str, object] = {
        "number": entry.number,
        "path": record.path,
        "model": record.model.value,
        "created": record.created_ns,
        "modified": record.modified_ns,
        "triples": unpack_triples(record.triples).decode("utf-8", "surrogateescape"),
    }
    if record.member is not None:
        members["member"] = record.member
    if record.blob is not None:
        members["blob"] = asdict(record.blob)
    if record.membership is not None:
        members["membership"] = asdict(record.membership)
    return members


def _entry(line: bytes) -> NumberedRecord:
    """Return the entry on a line. Raises ValueError, KeyError or TypeError for other contents."""
    members = json.loads(line)
    number, created, modified = members["number"], members["created"], members["modified"]
    if not all(type(value) is int and 0 < value < _MAX_NUMBER for value in (number, created, modified)):
        raise ValueError(f"{members['path']!r} has no valid number or time")
    blob, membership = members.get("blob"), members.get("membership")
    record = Record(
        _path(members["path"]),
        Model(members["model"]),
        0,
        created,
        modified,
        pack_triples(members["triples"].encode("utf-8", "surrogateescape")),
        None if blob is None else _blob(blob),
        None if membership is None else _membership(membership),
        None if members.get("member") is None else _member(members["member"]),
    )
    return NumberedRecord(number, record)


def _blob(members: Mapping[str, object]) -> Blob:
    size = members["size"]
    if type(size) is not int or not 0 <= size < _MAX_NUMBER:
        raise ValueError(f"{size!r} is not a size")
    return Blob(
        _require_match(ID, members["id"], "an id"),
        size,
        _require_match(_MEDIA_TYPE, members["media_type"], "a media type"),
    )


def _member(value: object) -> str:
    return NO_MEMBER if value == NO_MEMBER else _require_match(_IRI, value, "an IRI")


def _membership(members: Mapping[str, object]) -> Membership:
    content = members["content"]
    return Membership(
        _require_match(_IRI, members["resource"], "an IRI"),
        _require_match(_IRI, members["relation"], "an IRI"),
        members["inverse"] is True,
        None if content is None else _require_match(_IRI, content, "an IRI"),
    )


def _check(record: Record, sizes: dict[str, int]) -> None:
    """Raise ValueError if a record is invalid; add the size of its blob to `sizes`."""
    check_write(Put(record.path, record.model, blob=record.blob, membership=record.membership))
    if not container_of(record.path) and record.model is not Model.BASIC_CONTAINER:
        raise ValueError(f"{record.path} is not in a container")
    try:
        for _ in pyoxigraph.parse(unpack_triples(record.triples), pyoxigraph.RdfFormat.N_TRIPLES, lenient=True):
            pass
    except SyntaxError as error:
        raise ValueError(f"the triples of {record.path} are not valid N-Triples: {error}") from error
    if record.blob is not None:
        if record.blob.id in sizes:
            raise ValueError(f"two records refer to the file {record.blob.id}")
        sizes[record.blob.id] = record.blob.size


def _path(value: object) -> str:
    return _require_match(_PATH, value, "a path")


def _require_match(pattern: re.Pattern[str], value: object, kind: str) -> str:
    if not isinstance(value, str) or pattern.fullmatch(value) is None:
        raise ValueError(f"{value!r} is not {kind}")
    return value


def _line(value: object) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode() + b"\n"


def _add(tar: tarfile.TarFile, name: str, file: IO[bytes]) -> None:
    member = tarfile.TarInfo(name)
    member.size = file.seek(0, io.SEEK_END)
    file.seek(0)
    tar.addfile(member, file)


@contextlib.contextmanager
def _archive_errors() -> Iterator[None]:
    """Raise a ValueError with a message instead of the errors of reading a damaged archive."""
    try:
        yield
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"this is not a complete rosld dump: {error or type(error).__name__}") from error
    except ValueError as error:
        raise ValueError(f"this is not a valid rosld dump: {error}") from error
