"""The journal: its entries, their lifetime, in memory and on disk."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rosld.ontology.describe_activities import Receipt
from rosld.ontology.urls import Space
from rosld.server.auth.rules import Agent
from rosld.server.receipts.audit import AuditEntry, excerpt
from rosld.server.receipts.journal import DATABASE, Journal, NoSuchReceipt
from rosld.server.sparql.receipt_graphs import ReceiptGraphs

BASE = "http://robot.example/"


def asked(
    body: bytes | None = b'{"data": 1}',
    *,
    url: str = f"{BASE}topics/a",
    query: bytes = b"",
    status: int = 204,
    ended_ns: int | None = None,
    plan: tuple[str, ...] = ("publish",),
    words: str | None = None,
) -> AuditEntry:
    now = time.time_ns() if ended_ns is None else ended_ns
    kept, digest = (None, None) if body is None else excerpt(body)
    length = 0 if body is None else len(body)
    return AuditEntry(
        Agent("ann"), now - 1000, now, "PUT", url, query, "application/json", kept, length, digest, plan, (url,), 1,
        status, None, words,
    )  # fmt: skip


def journal(folder: Path | None = None, *, limit: int = 100, age: float = 3600.0, excerpt: int = 500) -> Journal:
    return Journal(folder, limit=limit, age=age, excerpt_bytes=excerpt)


def receipt(*requests: AuditEntry, excerpt: int = 500) -> Receipt:
    """Return the receipt of the last of these requests."""

    async def noted() -> Receipt:
        kept = journal(excerpt=excerpt)
        return kept.find([kept.add(each) for each in requests][-1]).receipt

    return asyncio.run(noted())


# Content of a receipt


def test_of_a_body_that_looks_like_credentials_nothing_is_told() -> None:
    for request_ in (
        asked(b'{"password": "hunter2"}', plan=("set the parameter /a to hunter2",), words="hunter2 is no number"),
        asked(b'"hunter2"', url=f"{BASE}parameters/wifi/password", plan=("set it to hunter2",), words="not hunter2"),
        asked(b"hunter2 " + b" " * 1000 + b'"the password"', words="hunter2 is no number"),
        asked(b'{"password": "hunter2"}' + b" " * 5000),  # too long to be stored: it has a digest
    ):
        found = receipt(request_)
        assert found.withheld
        assert (found.excerpt, found.digest) == (None, None)
        assert "hunter2" not in repr(found)


# Retention


async def test_the_oldest_go_first_and_refusals_push_out_nothing_that_was_done() -> None:
    kept = journal(limit=10)
    done = [kept.add(asked()) for _ in range(12)]
    refused = [kept.add(asked(status=422)) for _ in range(50)]
    assert [entry.id for entry in kept.newest_first()] == [*refused[:-3:-1], *done[:1:-1]]
    with pytest.raises(NoSuchReceipt):
        kept.find(done[0])


async def test_what_is_too_old_goes() -> None:
    kept = journal(age=60.0)
    old = kept.add(asked(ended_ns=time.time_ns() - 61_000_000_000))
    new = kept.add(asked())
    kept.start()
    assert [entry.id for entry in kept.newest_first()] == [new]
    with pytest.raises(NoSuchReceipt):
        kept.find(old)
    await kept.close()


# The disk


async def test_what_was_noted_is_on_the_disk_soon_and_what_was_forgotten_is_not(tmp_path: Path) -> None:
    kept = journal(tmp_path, limit=5)
    for _ in range(3):
        for _ in range(4):
            kept.add(asked())
        await until(lambda: numbers(tmp_path) == sorted(entry.number for entry in kept.newest_first()))
    await kept.close()


async def test_secrets_do_not_reach_the_disk(tmp_path: Path) -> None:
    kept = journal(tmp_path)
    kept.add(asked(b'{"password": "hunter2"}', words="hunter2"))
    await kept.close()
    assert not any(b"hunter2" in file.read_bytes() for file in tmp_path.iterdir())  # noqa: ASYNC240


async def test_a_disk_that_fails_refuses_no_write_and_is_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosld.server.receipts.journal._RETRY_SECONDS", 0.01)
    monkeypatch.setattr("rosld.server.receipts.journal._OPEN_SECONDS", 0.01)
    kept = journal(tmp_path)
    other = sqlite3.connect(tmp_path / DATABASE, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    first = kept.add(asked())
    await until(lambda: "kept in memory" in caplog.text)
    assert kept.find(first).receipt.agent == "ann"
    other.execute("ROLLBACK")
    other.close()
    await until(lambda: len(numbers(tmp_path)) == 1)
    await kept.close()


def test_a_file_that_is_no_database_of_receipts_is_refused(tmp_path: Path) -> None:
    (tmp_path / DATABASE).write_bytes(b"no database" * 1000)
    with pytest.raises(ValueError, match="receipts"):
        journal(tmp_path)


def numbers(folder: Path) -> list[int]:
    connection = sqlite3.connect(folder / DATABASE)
    try:
        return [number for (number,) in connection.execute("SELECT number FROM receipt ORDER BY number")]
    finally:
        connection.close()


async def until(holds: Callable[[], bool]) -> None:
    async def wait() -> None:
        while not holds():  # noqa: ASYNC110 - what is waited for is in a file
            await asyncio.sleep(0.01)

    await asyncio.wait_for(wait(), 60)


# The dataset


async def test_the_dataset_is_told_what_came_and_what_went() -> None:
    kept = journal(limit=3)
    graphs = ReceiptGraphs(kept, Space(BASE))
    held: dict[str, str] = {}
    version = 0

    def catch_up() -> None:
        nonlocal version
        for part in graphs.changes(version):
            for iri, render in part.graphs.items():
                if render is None:
                    held.pop(iri, None)
                else:
                    held[iri] = render()
            for edit in part.edits:
                lines = set(held.get(edit.graph, "").splitlines()) - set(edit.removed.splitlines())
                held[edit.graph] = "\n".join(sorted(lines | set(edit.added.splitlines())))
        version = graphs.version

    container = f"{BASE}activity/"
    for count in (0, 2, 1, 7, 1):
        for _ in range(count):
            kept.add(asked())
        catch_up()
        urls = {f"{BASE}activity/{entry.id}" for entry in kept.newest_first()}
        assert held.keys() == {container, *urls}
        assert held[container].count("ldp#contains") == len(urls)
        assert all(url in held[container] for url in urls)
