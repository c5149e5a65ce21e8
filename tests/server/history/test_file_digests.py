"""Digests of recordings: of the one file that has the messages, computed once and told when they are known."""

from __future__ import annotations

import asyncio
import hashlib
from pathlib import Path

import pytest

from rosld.server.history.file_digests import FileDigests


async def known(digests: FileDigests, path: Path) -> str | None:
    """What a digest is once it is known."""
    found = asyncio.Event()
    watch = digests.watch(path, found.set)
    assert digests.get(path) is None
    await asyncio.wait_for(found.wait(), 60)
    watch.close()
    return digests.get(path)


@pytest.mark.parametrize("files", [("run.bag",), ("run/metadata.yaml", "run/run_0.mcap"), ("run/run_0.db3",)])
def test_the_digest_is_that_of_the_file_with_the_messages(tmp_path: Path, files: tuple[str, ...]) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode() * 500_000)
    path = tmp_path / files[0].partition("/")[0]
    expected = hashlib.sha256((tmp_path / files[-1]).read_bytes()).hexdigest()
    assert asyncio.run(known(FileDigests(), path)) == expected


def test_a_file_is_read_once(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    path.write_bytes(b"before")

    async def twice() -> tuple[str | None, str | None]:
        digests = FileDigests()
        first = await known(digests, path)
        path.unlink()
        return first, digests.get(path)

    first, second = asyncio.run(twice())
    assert first == second == hashlib.sha256(b"before").hexdigest()
