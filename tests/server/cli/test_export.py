"""`rosld export`: recordings as folders of tables."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rosld.adapters.base import Recording
from rosld.server.cli.export import ExportJob
from rosld.server.cli.main import main
from rosld.server.cli.parts import Outcome, Part
from tests.runs import write_run

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'rosld[parquet]'")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two runs of 6 s and 2 s, in two formats."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "long.mcap", seconds=6)
    write_run(folder / "short 1.bag", seconds=2)
    return folder


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut recordings into parts of 150 messages, and blocks of 50."""
    monkeypatch.setattr("rosld.server.cli.parts.BLOCK_MESSAGES", 50)
    monkeypatch.setattr(ExportJob, "part_messages", 150)


def export(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["export", *map(str, arguments)])


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def exported(*arguments: str | Path) -> dict[str, bytes]:
    """Return the files that the command wrote into its last argument."""
    result = export(*arguments[:-1], "-o", arguments[-1])
    assert result.exit_code == 0, result.output
    assert not list(Path(arguments[-1]).parent.glob(".*"))
    return files(Path(arguments[-1]))


def test_each_topic_of_each_run_is_a_table(folder: Path, tmp_path: Path) -> None:
    found = exported(folder, tmp_path / "new" / "tables")
    topics = ["battery_state", "cmd_vel", "diagnostics", "imu", "odom"]
    assert sorted(found) == sorted(
        f"topic={topic}/run={run}/part-0.parquet" for topic in topics for run in ("long", "short 1")
    )
    table = parquet.read_table(tmp_path / "new" / "tables", columns=["index"])
    assert len(table) == 6 * 74 + 2 * 74
    odometry = parquet.read_table(tmp_path / "new" / "tables" / "topic=odom")
    assert odometry["twist.twist.linear.x"].type == "double"
    assert set(odometry["run"].to_pylist()) == {"long", "short 1"}


def test_parts_cover_all_messages_once(folder: Path, tmp_path: Path, small_parts: None) -> None:
    found = exported(folder / "long.mcap", tmp_path / "tables")
    assert [f"topic=imu/run=long/part-{number}.parquet" in found for number in range(4)] == [True, True, True, False]
    numbers = [
        number
        for topic in (tmp_path / "tables").iterdir()
        for number in parquet.read_table(topic, columns=["index"])["index"].to_pylist()
    ]
    assert sorted(numbers) == list(range(444))


@pytest.mark.parametrize("format", ["parquet", "csv", "arrow"])
def test_a_part_for_which_there_is_too_little_memory_is_cut_in_two_which_leaves_no_trace(
    format: str, folder: Path, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = exported(folder, "--format", format, tmp_path / "whole")
    make = ExportJob.make
    refused: list[Part] = []

    def lacking(job: ExportJob, recording: Recording, part: Part, *arguments: object, **options: bool) -> Outcome:
        if part.end - part.start > 50:
            refused.append(part)
            raise MemoryError
        return make(job, recording, part, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(ExportJob, "make", lacking)
    assert exported(folder, "--format", format, tmp_path / "cut") == whole
    assert refused


def test_runs_without_a_failed_part_are_written_and_the_same_command_adds_the_others(
    folder: Path, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = exported(folder, tmp_path / "whole")
    make = ExportJob.make
    made: list[int] = []

    def fails(job: ExportJob, recording: Recording, part: Part, *arguments: object, **options: bool) -> Outcome:
        made.append(part.start)
        if part.start == 150 and len(made) == 2:
            raise ValueError("there is a knot in it")
        return make(job, recording, part, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(ExportJob, "make", fails)
    result = export(folder, "-o", tmp_path / "tables")
    assert result.exit_code == 6
    assert "long.mcap, messages 150 to 299: there is a knot in it" in result.stderr
    assert files(tmp_path / "tables") == {name: data for name, data in whole.items() if "run=short 1" in name}
    made.clear()
    assert exported(folder, tmp_path / "tables") == whole
    assert made == [150]


def test_files_of_the_same_topic_and_run_are_replaced_and_others_remain(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(ExportJob, "part_messages", 100)
        patch.setattr("rosld.server.cli.parts.BLOCK_MESSAGES", 50)
        before = exported(folder / "long.mcap", tmp_path / "tables")
    (tmp_path / "tables" / "notes.txt").write_text("mine")
    after = exported(folder / "long.mcap", "--topic", "/odom", tmp_path / "tables")
    assert [name for name in after if "topic=odom" in name] == ["topic=odom/run=long/part-0.parquet"]
    assert {name for name in after if "odom" not in name} == {
        "notes.txt",
        *(name for name in before if "odom" not in name),
    }
