"""Records in memory and in a folder: the contract is one."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import TypeAlias

import pytest

from rosld.server.storage import SqliteRecords, open_records

Opened: TypeAlias = Callable[[], AbstractAsyncContextManager[SqliteRecords]]


@asynccontextmanager
async def opened(folder: Path | None) -> AsyncIterator[SqliteRecords]:
    records = open_records(folder, roots=("queries/",))
    try:
        yield records
    finally:
        await records.close()


@pytest.fixture(params=["memory", "folder"])
def records(request: pytest.FixtureRequest, tmp_path: Path) -> Opened:
    """What opens new records, in memory and in a folder."""
    return lambda: opened(tmp_path if request.param == "folder" else None)


@pytest.fixture
def kept(tmp_path: Path) -> Opened:
    """What opens the records of one folder, again and again."""
    return lambda: opened(tmp_path)
