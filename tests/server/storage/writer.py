"""A process that writes records until it is killed.

Before each write it sends `began LANE KIND NUMBER`, and on its acknowledgement `done LANE KIND NUMBER VERSION`. `text`
and `data` return the content for a number.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from multiprocessing.connection import Connection
from pathlib import Path

from rosld.server.storage.record import Model, Put, Remove, Write
from rosld.server.storage.sqlite import Records, open_records

LANES = 3
KINDS = ("rdf", "file", "pair", "brief", "away")


def text(number: int) -> bytes:
    """Return triples, from a few bytes to several pages."""
    return b'<http://a/b> <http://a/c> "%s" .\n' % (b"%d," % number * (1 + number % 7 * 400))


def data(number: int) -> bytes:
    """Return the bytes of a file, from a few to more than are written at once."""
    return b"%d;" % number * (1 + number % 5 * 20_000)


def paths(lane: int, kind: str, number: int) -> list[str]:
    """Return the paths of a write."""
    if kind == "pair":
        return [f"data/{lane}/a", f"data/{lane}/b"]
    return [f"data/{lane}/{kind}" if kind in ("rdf", "file") else f"data/{lane}/brief{number}"]


async def parts(number: int) -> AsyncIterator[bytes]:
    whole = data(number)
    for start in range(0, len(whole), 50_000):
        yield whole[start : start + 50_000]
        await asyncio.sleep(0)


async def writes(records: Records, lane: int, kind: str, number: int) -> list[Write]:
    names = paths(lane, kind, number)
    if kind == "away":
        return [Remove(names[0])]
    if kind == "file":
        blob = await records.receive(parts(number), "x/y", limit=10**7)
        return [Put(names[0], Model.NON_RDF_SOURCE, text(number), blob)]
    return [Put(name, Model.RDF_SOURCE, text(number)) for name in names]


async def work(records: Records, lane: int, first: int, say: Callable[[list[str]], None]) -> None:
    if records.get(f"data/{lane}/") is None:
        await records.write(Put(f"data/{lane}/", Model.BASIC_CONTAINER))
    for number in range(first, first + 100_000):
        for kind in KINDS:
            say(["began", str(lane), kind, str(number)])
            results = await records.write(*await writes(records, lane, kind, number))
            version = results[0].version if results[0] is not None else 0
            say(["done", str(lane), kind, str(number), str(version)])


async def main(folder: Path, first: int, say: Callable[[list[str]], None]) -> None:
    records = open_records(folder)
    say(["open"])
    await asyncio.gather(*(work(records, lane, first, say) for lane in range(LANES)))


def run(folder: Path, first: int, output: Connection) -> None:
    """Write from this number on, and report progress."""
    asyncio.run(main(folder, first, output.send))
