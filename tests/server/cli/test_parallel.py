"""Conversion of recordings in parts: cut, resumed, retried, and the same bytes in every case."""

from __future__ import annotations

import gzip
import multiprocessing
import random
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pyoxigraph import RdfFormat, parse

import rosld
from rosld.adapters.base import Recording
from rosld.server.cli import lift as lift_module
from rosld.server.cli.lift import LiftJob
from rosld.server.cli.main import main
from rosld.server.cli.parts import Cut, Job, Outcome, Part, run_task
from rosld.server.cli.recording_inputs import Selection
from tests.runs import write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 6 s: 444 messages."""
    return write_run(tmp_path_factory.mktemp("run") / "run.mcap", seconds=6)


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut recordings into parts of 150 messages, and blocks of 50."""
    monkeypatch.setattr("rosld.server.cli.parts.BLOCK_MESSAGES", 50)
    monkeypatch.setattr(lift_module, "_PART_MESSAGES", 150)


def lift(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["lift", *map(str, arguments)])


def lifted(output: Path, *arguments: str | Path) -> bytes:
    """Return the file that the command wrote."""
    result = lift(*arguments, "-o", output)
    assert result.exit_code == 0, result.output
    assert [path.name for path in output.parent.iterdir() if path.name.startswith(".")] == []
    return output.read_bytes()


def lines(text: bytes) -> set[str]:
    return {str(quad.subject) for quad in parse(text, format=RdfFormat.N_QUADS)}


def test_a_cut_covers_all_messages_once_in_parts_of_whole_blocks() -> None:
    job = Job(selection=Selection())
    for count, size in ((0, 10), (1, 10), (2500, 40 << 20), (100_000, 1 << 30)):
        cut = Cut(count, 100, "", is_selected=True)
        parts = cut.parts(0, size, job)
        assert len(parts) >= size // job.part_bytes
        assert [part.start for part in parts] == [0, *(part.end for part in parts[:-1])]
        assert parts[-1].end == count
        assert all(part.start % 100 == 0 for part in parts)
        for part in parts:
            halves = cut.halves(part)
            assert not halves or (halves[0].start, halves[-1].end) == (part.start, part.end)


def test_a_part_for_which_there_is_too_little_memory_is_cut_in_two_which_leaves_no_trace(
    run: Path, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = lifted(tmp_path / "whole.nq.gz", run)
    make = LiftJob.make
    refused: list[Part] = []

    def lacking(job: LiftJob, recording: Recording, part: Part, *arguments: object, **options: bool) -> Outcome:
        if part.end - part.start > 50:
            refused.append(part)
            raise MemoryError
        return make(job, recording, part, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(LiftJob, "make", lacking)
    assert lifted(tmp_path / "cut.nq.gz", run) == whole
    assert refused


def test_a_part_that_fails_is_named_and_ends_no_other_and_the_same_command_computes_only_that(
    run: Path, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = lifted(tmp_path / "whole.nq", run)
    make = LiftJob.make
    made: list[int] = []
    failing = {150}

    def fails(job: LiftJob, recording: Recording, part: Part, *arguments: object, **options: bool) -> Outcome:
        made.append(part.start)
        if part.start in failing:
            raise ValueError("there is a knot in it")
        return make(job, recording, part, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(LiftJob, "make", fails)
    result = lift(run, "-o", tmp_path / "x.nq")
    assert result.exit_code != 0
    assert f"{run}, messages 150 to 299: there is a knot in it" in result.stderr
    assert made == [0, 150, 300]
    assert not (tmp_path / "x.nq").exists()
    made.clear()
    failing.clear()
    assert lifted(tmp_path / "x.nq", run) == whole
    assert made == [150]


def test_work_on_another_file_does_not_continue_with_parts_of_this_one(
    run: Path, tmp_path: Path, small_parts: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(LiftJob, "make", lambda *_, **__: 1 / 0)
        assert "ZeroDivisionError" in lift(run, "-o", tmp_path / "x.nq").stderr
    other = write_run(tmp_path / "other.bag", seconds=5)
    assert lifted(tmp_path / "x.nq", other) == lifted(tmp_path / "y.nq", other)


def test_several_recordings_and_folders_are_never_merged_and_have_names_of_their_own(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    for name in ("monday", "tuesday", "killed"):
        (folder / name).mkdir(parents=True)
    write_run(folder / "monday" / "run.mcap", seconds=1)
    write_run(folder / "tuesday" / "run.bag", seconds=1)
    write_run(folder / "night", seconds=1)
    write_run(folder / "killed" / "killed_0.mcap", seconds=1)
    (folder / "foreign.mcap").write_bytes(b"no recording")
    (folder / "notes.txt").write_text("no recording either")
    result = lift(folder, folder / "night", "-o", tmp_path / "x.nq")
    assert "foreign.mcap is left out" in result.stderr
    assert "1 of 5 recordings" in result.stderr
    assert result.exit_code != 0
    base = "<http://127.0.0.1:8080/bags/"
    found = {
        line.removeprefix(base).partition("/")[0] for line in lines((tmp_path / "x.nq").read_bytes()) if base in line
    }
    assert found == {"monday-run", "tuesday-run", "night", "killed"}


def test_messages_are_selected_by_topic_and_time_and_keep_their_numbers(run: Path, tmp_path: Path) -> None:
    def messages(*arguments: str) -> set[str]:
        return {line for line in lines(lifted(tmp_path / "x.nq", run, *arguments)) if line.endswith("#message>")}

    every = messages()
    odometry = messages("--topic", "/odo*")
    assert 0 < len(odometry) < len(every)
    assert odometry < every
    late = messages("--topic", "odom", "--from", "-2")
    assert late < odometry
    assert messages("--topic", "odom", "--from", "4") == late
    assert messages("--topic", "odom", "--to", "2023-11-14T22:13:24Z") | late == odometry
    none = lift(run, "-o", tmp_path / "x.nq", "--from", "100")
    assert (none.exit_code, none.stderr) == (0, "rosld: no message was recorded on these topics at these times\n")
    result = lift(run, "-o", tmp_path / "y.nq", "--topic", "/none")
    assert "/none" in result.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "x.nq"]


def test_stdout_is_an_output(run: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["lift", str(run), "-o", "-", "--format", "nq.gz", "--topic", "/battery_state"])
    assert result.exit_code == 0
    plain = gzip.decompress(result.stdout_bytes)
    assert plain == lifted(tmp_path / "x.nq", run, "--topic", "/battery_state")


def test_a_worker_refuses_a_task_of_another_version() -> None:
    answer = run_task("0.0.1", b"anything")
    assert answer.is_final
    assert rosld.__version__ in str(answer.error)
    assert "0.0.1" in str(answer.error)


@pytest.mark.slow
def test_workers_that_are_killed_at_random_leave_no_trace(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lift_module, "_PART_MESSAGES", 1000)
    long = write_run(tmp_path / "long.bag", seconds=200)
    whole = lifted(tmp_path / "whole.nt.gz", long, "--workers", "1")
    killed = 0
    is_over = threading.Event()
    manifest = tmp_path / ".x.nt.gz.parts" / "manifest.jsonl"

    def kill() -> None:
        nonlocal killed
        dice, size = random.Random(1), 0
        while not is_over.wait(0.02) and killed < 3:
            grown = manifest.stat().st_size if manifest.exists() else 0
            if grown > size and (workers := multiprocessing.active_children()):
                size = grown
                dice.choice(workers).kill()
                killed += 1

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        assert lifted(tmp_path / "x.nt.gz", long, "--workers", "2") == whole
    finally:
        is_over.set()
        killer.join()
    assert killed >= 1
