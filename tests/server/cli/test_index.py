"""`rosld index`: statistics that a server then answers from, without opening a file."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from click.testing import CliRunner

from rosld.server.cli.main import main
from tests import runs

pytestmark = pytest.mark.slow


def test_index_keeps_statistics_with_the_catalogue_and_reads_nothing_twice(tmp_path: Path) -> None:
    runs.write_run(tmp_path / "first.mcap", seconds=5)
    runs.write_run(tmp_path / "second.bag", seconds=5, seed=1)
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    result = CliRunner().invoke(main, ["index", str(tmp_path), "--workers", "1"])
    assert result.exit_code == 0, result.output
    assert f"2 recordings are indexed in {tmp_path / '.rosld.sqlite'}" in result.output
    with sqlite3.connect(tmp_path / ".rosld.sqlite") as db:
        query = (
            "SELECT count(DISTINCT content), sum(count), min(minimum) FROM topic_statistic WHERE field = 'percentage'"
        )
        assert db.execute(query).fetchone()[:2] == (2, 10)
        db.execute("UPDATE topic_statistic SET count = 100 WHERE field = 'percentage'")
    db.close()
    (tmp_path / "first.mcap").rename(tmp_path / "moved.mcap")
    assert CliRunner().invoke(main, ["index", str(tmp_path / "moved.mcap"), "--workers", "1"]).exit_code == 0
    with sqlite3.connect(tmp_path / ".rosld.sqlite") as db:
        assert db.execute("SELECT sum(count) FROM topic_statistic WHERE field = 'percentage'").fetchone() == (200,)
    db.close()
