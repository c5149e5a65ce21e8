"""Records in a folder."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import TypeAlias

import pytest

from rosld.server.storage.sqlite import Records, open_records

Opened: TypeAlias = Callable[[], AbstractAsyncContextManager[Records]]


@asynccontextmanager
async def opened(folder: Path) -> AsyncIterator[Records]:
    records = open_records(folder, roots=("queries/",))
    try:
        yield records
    finally:
        await records.close()


@pytest.fixture
def records(tmp_path: Path) -> Opened:
    """A function that opens the records of one folder, repeatedly."""
    return lambda: opened(tmp_path)
