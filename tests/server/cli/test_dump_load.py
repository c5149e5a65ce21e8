"""`rosld dump` and `rosld load`: a copy of clients' data, created and restored with or without a running server."""

from __future__ import annotations

import asyncio
import gzip
import io
import json
import tarfile
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rosld.server.cli.data_folder import bind_base, lock, read_base
from rosld.server.cli.main import main
from rosld.server.storage.record import Blob, Membership, Model, Put, Record, RecordChange, Remove
from rosld.server.storage.sqlite import Records, open_records

BASE = "http://robot.example/"
OTHER = "https://data.example/robot/"
TRIPLES = f'<{BASE}data/a> <{BASE}says> "<{BASE}data/a> \\"01"^^<http://www.w3.org/2001/XMLSchema#integer> .\n'.encode()


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def done(*arguments: object) -> str:
    """Return the stderr of a successful command."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    return result.stderr


def failure(*arguments: object) -> str:
    """Return the one-line error of a failing command."""
    result = run(*arguments)
    assert result.exit_code == 1, result.output
    assert result.stderr.startswith("rosld: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


async def sent(data: bytes) -> AsyncIterator[bytes]:
    yield data


async def put_file(records: Records, path: str, data: bytes) -> Blob:
    blob = await records.receive(sent(data), "text/x-test; charset=utf-8", limit=10**9)
    await records.write(Put(path, Model.NON_RDF_SOURCE, TRIPLES, blob))
    return blob


async def fill(records: Records) -> None:
    membership = Membership(f"{BASE}data/a", f"{BASE}has", inverse=True, content="http://x/about")
    await records.write(
        Put("data/a", Model.RDF_SOURCE, TRIPLES),
        Put("data/c/", Model.BASIC_CONTAINER),
        Put("data/c/i/", Model.INDIRECT_CONTAINER, membership=membership),
        Put("data/c/i/m", Model.RDF_SOURCE, member=f"{BASE}data/m#it"),
        Put("data/old", Model.RDF_SOURCE),
    )
    await records.write(Remove("data/old"))
    await put_file(records, "data/c/file", b"bytes" * 100)


def told(records: Records) -> dict[str, tuple[object, ...]]:
    """Return everything in all records except their versions and the ids of their blobs."""
    return {one.path: _told(records, records.get(one.path)) for one in records.changes_since(0)}


def _told(records: Records, record: Record | None) -> tuple[object, ...]:
    if record is None:
        return ()
    data = None if record.blob is None else (records.file(record.blob).read_bytes(), record.blob.media_type)
    members = [(one.number, one.path, one.member) for one in records.members(record.path)]
    return (record.model, record.created_ns, record.triples, record.membership, record.member, data, members)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data folder with all kinds of data, without a running server."""

    async def make() -> None:
        records = open_records(tmp_path / "data", roots=("queries/",))
        await fill(records)
        await records.close()

    bind_base(tmp_path / "data", BASE)
    asyncio.run(make())
    return tmp_path / "data"


def contents(folder: Path) -> dict[str, tuple[object, ...]]:
    async def read() -> dict[str, tuple[object, ...]]:
        records = open_records(folder, roots=("queries/",))
        try:
            return told(records)
        finally:
            await records.close()

    return asyncio.run(read())


def test_a_dump_brings_everything_back_into_a_new_folder(folder: Path, tmp_path: Path) -> None:
    assert "7 resources, 1 of them files" in done("dump", folder, "-o", tmp_path / "d.tar.gz")
    done("load", tmp_path / "d.tar.gz", tmp_path / "new" / "data")
    assert contents(tmp_path / "new" / "data") == contents(folder)
    assert read_base(tmp_path / "new" / "data") == BASE
    assert contents(folder)["data/old"] == ()


def test_the_same_records_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    done("dump", folder, "-o", tmp_path / "1.tar.gz")
    done("dump", folder, "-o", tmp_path / "2.tar.gz")
    assert (tmp_path / "1.tar.gz").read_bytes() == (tmp_path / "2.tar.gz").read_bytes()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.slow
def test_what_is_there_gives_way_and_what_was_deleted_since_comes_back(folder: Path, tmp_path: Path) -> None:
    before = contents(folder)
    done("dump", folder, "-o", tmp_path / "d.tar.gz")

    async def change() -> None:
        records = open_records(folder)
        await records.write(Remove("data/a"), Put("data/later", Model.RDF_SOURCE))
        await records.write(Put("data/c/", Model.BASIC_CONTAINER, b"<http://a/b> <http://a/b> <http://a/b> .\n"))
        await put_file(records, "data/c/file", b"other bytes")
        await records.close()

    asyncio.run(change())
    done("load", tmp_path / "d.tar.gz", folder)
    assert contents(folder) == before | {"data/later": ()}
    assert len(list((folder / "blobs").iterdir())) == 1


async def test_a_running_server_is_dumped_as_it_was_at_one_moment(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    bind_base(folder, BASE)
    records = open_records(folder)
    await put_file(records, "data/file", b"0")
    stop = asyncio.Event()

    async def write() -> int:
        count = 0
        while not stop.is_set():
            count += 1
            number = b"%d" % count
            blob = await records.receive(sent(number * 1000), "text/plain", limit=10**6)
            await records.write(
                Put("data/file", Model.NON_RDF_SOURCE, blob=blob),
                Put("data/a", Model.RDF_SOURCE, b'<http://a/b> <http://a/b> "%s" .\n' % number),
            )
        return count

    writing = asyncio.create_task(write())
    for number in range(3):
        archive = tmp_path / f"{number}.tar.gz"
        await asyncio.to_thread(done, "dump", folder, "-o", archive)
        await asyncio.to_thread(done, "load", archive, tmp_path / f"copy{number}")
    stop.set()
    assert await writing > 3
    await records.close()
    assert len(list((folder / "blobs").iterdir())) == 1  # no blobs of the dumps are left
    for number in range(3):
        copy = open_records(tmp_path / f"copy{number}")
        file, triples = copy.get("data/file"), copy.get("data/a")
        assert file is not None
        assert file.blob is not None
        if triples is not None:
            word = triples.triples.split(b'"')[1]
            assert copy.file(file.blob).read_bytes() == word * 1000
        await copy.close()


@pytest.mark.slow
async def test_a_running_server_goes_on_with_what_is_loaded(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    bind_base(folder, BASE)
    with lock(folder):
        records = open_records(folder)
        await fill(records)
        before = told(records)
        await asyncio.to_thread(done, "dump", folder, "-o", tmp_path / "d.tar.gz")
        await records.write(Remove("data/a"), Put("data/later", Model.RDF_SOURCE))
        old = await put_file(records, "data/c/file", b"new")
        version, changes, noticed = records.version, list[RecordChange](), asyncio.Event()

        def wake(changed: object) -> None:
            changes.extend(changed)  # type: ignore[arg-type]
            noticed.set()

        records.watch(wake)
        loading = asyncio.create_task(asyncio.to_thread(done, "load", tmp_path / "d.tar.gz", folder))
        await asyncio.wait_for(noticed.wait(), 60)
        assert records.file(old).read_bytes() == b"new"  # for a client that has just started reading
        assert told(records) == before | {"data/later": ()}
        assert not records.is_tombstone("data/a")
        assert {one.path: one.is_removed for one in changes} | {"data/old": True} == {
            path: not before.get(path) for path in told(records)
        }
        assert min(one.version for one in changes) > version
        loaded = max(one.version for one in changes)
        await loading
        with pytest.raises(FileNotFoundError):
            records.file(old)
        (record,) = await records.write(Put("data/a", Model.RDF_SOURCE))
        assert record is not None
        assert record.version > loaded
        assert records.is_tombstone("data/later")
        await records.close()


async def test_a_load_at_full_speed_loses_no_acknowledged_write_after_it(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    bind_base(folder, BASE)
    records = open_records(folder)
    for batch in range(20):
        await records.write(*(Put(f"data/{batch}-{n}", Model.RDF_SOURCE, TRIPLES) for n in range(100)))
    await asyncio.to_thread(done, "dump", folder, "-o", tmp_path / "d.tar.gz")
    acknowledged: list[tuple[int, int]] = []
    loading = asyncio.create_task(asyncio.to_thread(done, "load", tmp_path / "d.tar.gz", folder))
    number = 0
    while not loading.done() or number < 20:
        number += 1
        (record,) = await records.write(Put("data/0-0", Model.RDF_SOURCE, b"%d" % number))
        assert record is not None
        acknowledged.append((record.version, number))
    assert [version for version, _ in acknowledged] == sorted(version for version, _ in acknowledged)
    found = records.get("data/0-0")
    assert found is not None
    assert found.version == acknowledged[-1][0]
    container = records.get("data/")
    assert container is not None
    assert container.count == 2000
    records.clear_cache()
    assert records.get("data/") == container
    await records.close()


def test_a_dump_of_another_base_is_refused_or_rewritten(folder: Path, tmp_path: Path) -> None:
    done("dump", folder, "-o", tmp_path / "d.tar.gz")
    bind_base(tmp_path / "other", OTHER)
    words = failure("load", tmp_path / "d.tar.gz", tmp_path / "other")
    assert f"belongs to {BASE}" in words
    assert f"--base-url {OTHER}" in words
    assert f"belongs to {BASE}" in failure("load", tmp_path / "d.tar.gz", folder, "--base-url", OTHER)
    done("load", tmp_path / "d.tar.gz", tmp_path / "other", "--base-url", OTHER.removesuffix("/"))
    there = contents(tmp_path / "other")
    assert there["data/a"][2] == TRIPLES.replace(b"<" + BASE.encode(), b"<" + OTHER.encode()).replace(
        b'"<' + OTHER.encode(), b'"<' + BASE.encode()
    )
    assert there["data/c/i/"][3] == Membership(f"{OTHER}data/a", f"{OTHER}has", inverse=True, content="http://x/about")
    assert there["data/c/i/m"][4] == f"{OTHER}data/m#it"


def test_folders_without_records_are_refused(tmp_path: Path) -> None:
    assert "is not a rosld data folder" in failure("dump", tmp_path, "-o", tmp_path / "d.tar.gz")
    bind_base(tmp_path, BASE)
    assert "holds no records" in failure("dump", tmp_path, "-o", tmp_path / "d.tar.gz")
    assert not (tmp_path / "d.tar.gz").exists()
    assert run("dump", tmp_path / "nowhere", "-o", tmp_path / "d.tar.gz").exit_code == 2


def line(**more: object) -> dict[str, object]:
    return {"number": 1, "path": "data/", "model": "BasicContainer", "created": 1, "modified": 1, "triples": ""} | more


def archive(path: Path, members: Mapping[str, bytes]) -> Path:
    with tarfile.open(path, "w:gz") as tar:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return path


def made_up(*lines: object, about: Mapping[str, object] = {}, **blobs: bytes) -> dict[str, bytes]:
    return {
        "rosld.json": json.dumps({"format": 1, "base": BASE} | dict(about)).encode(),
        "records.jsonl": b"".join(json.dumps(one).encode() + b"\n" for one in lines),
        "gone.jsonl": b'"data/gone"\n',
        **{f"blobs/{name}": data for name, data in blobs.items()},
    }


ID = "0123456789abcdef0123456789abcdef"
FILE = {"number": 2, "path": "data/f", "model": "NonRDFSource"}


def blob(**more: object) -> dict[str, object]:
    return {"blob": {"id": ID, "size": 3, "media_type": "text/plain"} | more}


HOSTILE: Mapping[str, Mapping[str, bytes]] = {
    "empty": {},
    "without records": {"rosld.json": made_up()["rosld.json"]},
    "of a newer format": made_up(line(), about={"format": 9}),
    "without a base": made_up(line(), about={"base": None}),
    "with a base that is none": made_up(line(), about={"base": "file:///etc/"}),
    "no JSON": {**made_up(), "records.jsonl": b"{"},
    "a list": made_up([]),
    "a number": made_up(7),
    "without a path": made_up({"number": 1}),
    "a path upwards": made_up(line(), line(number=2, path="data/a b", model="RDFSource")),
    "a path with a header": made_up(line(), line(number=2, path="data/a\r\nX: y", model="RDFSource")),
    "an empty segment": made_up(line(), line(number=2, path="data//", model="BasicContainer")),
    "a member without its container": made_up(line(), line(number=2, path="data/a/b", model="RDFSource")),
    "a member before its container": made_up(
        line(), line(number=2, path="data/a/b", model="RDFSource"), line(number=3, path="data/a/")
    ),
    "a root that is no container": made_up(line(path="a", model="RDFSource")),
    "twice": made_up(line(), line(number=2)),
    "one number twice": made_up(line(), line(path="queries/")),
    "a number beyond": made_up(line(number=2**63)),
    "an unknown model": made_up(line(model="Thing")),
    "a container without a slash": made_up(line(), line(number=2, path="data/c")),
    "triples that are none": made_up(line(triples="hello")),
    "an IRI that is none": made_up(line(member="<>")),
    "a membership that is none": made_up(line(), line(number=2, path="data/c/", model="DirectContainer")),
    "a file that is missing": made_up(line(), line(**FILE, **blob())),
    "a file that is short": made_up(line(), line(**FILE, **blob()), **{ID: b"12"}),
    "a file that is long": made_up(line(), line(**FILE, **blob()), **{ID: b"1234"}),
    "a file that nobody refers to": made_up(line(), **{ID: b"123"}),
    "one file of two": made_up(
        line(), line(**FILE, **blob()), line(**{**FILE, "number": 3, "path": "data/g"}, **blob()), **{ID: b"123"}
    ),
    "an id that is a path": made_up(line(), line(**FILE, **blob(id="../../x"))),
    "a media type with a header": made_up(line(), line(**FILE, **blob(media_type="a/b\r\nX: y")), **{ID: b"123"}),
    "something after it": {**made_up(line()), "../../x": b"x"},
}


def test_a_dump_that_is_not_sound_changes_nothing(folder: Path, tmp_path: Path) -> None:
    before = contents(folder)
    for name, members in HOSTILE.items():
        words = failure("load", archive(tmp_path / "d.tar.gz", members), folder)
        assert "dump" in words or "base" in words, name
        assert contents(folder) == before, name
        assert len(list((folder / "blobs").iterdir())) == 1, name
    failure("load", tmp_path / "d.tar.gz", tmp_path / "new")
    assert read_base(tmp_path / "new") is None


def test_a_sound_dump_can_be_made_up(tmp_path: Path) -> None:
    lines = (line(), line(**FILE, **blob()))
    done("load", archive(tmp_path / "d.tar.gz", made_up(*lines, **{ID: b"123"})), tmp_path / "new")
    there = contents(tmp_path / "new")
    assert there["data/f"][5] == (b"123", "text/plain")
    assert there["data/gone"] == ()


def test_a_broken_file_is_refused(folder: Path, tmp_path: Path) -> None:
    done("dump", folder, "-o", tmp_path / "d.tar.gz")
    data = (tmp_path / "d.tar.gz").read_bytes()
    for broken in (data[: len(data) // 2], data[:-8] + bytes(8), gzip.decompress(data), b""):
        (tmp_path / "d.tar.gz").write_bytes(broken)
        assert "dump" in failure("load", tmp_path / "d.tar.gz", tmp_path / "new")
