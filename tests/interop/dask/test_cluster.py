"""A Dask cluster whose workers, processes of their own, read recordings from an S3-compatible server."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from rosld.server.cli.main import main
from tests.processes import Process
from tests.runs import write_run
from tests.server.dataset.conftest import free_port

REASON = "is not installed: pip install '.[interop,dask,files,parquet]'"
pytest.importorskip("distributed", reason=f"distributed {REASON}")
moto = pytest.importorskip("moto.server", reason=f"moto {REASON}")
parquet = pytest.importorskip("pyarrow.parquet", reason=f"pyarrow {REASON}")
s3fs = pytest.importorskip("s3fs", reason=f"s3fs {REASON}")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of recordings in all formats."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "long.mcap", seconds=60)
    write_run(folder / "old.bag", seconds=5)
    write_run(folder / "base.db3", seconds=5)
    write_run(folder / "folder", seconds=5)
    return folder


@pytest.fixture(scope="module")
def s3(runs: Path) -> Iterator[str]:
    """The URL of the recordings in a bucket; the environment leads clients to it."""
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ACCESS_KEY_ID", "test")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "test")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        store = s3fs.S3FileSystem()
        store.mkdir("fleet")
        store.put(f"{runs}/", "fleet/monday/", recursive=True)
        yield "s3://fleet/monday"
    server.stop()


@pytest.fixture
def cluster(s3: str) -> Iterator[tuple[str, list[Process]]]:
    """The address of a scheduler, and its two workers."""
    dask = str(Path(sys.executable).with_name("dask"))
    address = f"tcp://127.0.0.1:{free_port()}"
    started: list[Process] = []

    def start(*arguments: str) -> Process:
        started.append(Process([dask, *arguments], {**os.environ, "PYTHONUNBUFFERED": "1"}, patience=60))
        return started[-1]

    try:
        scheduler = start("scheduler", "--host", address, "--no-dashboard")
        while "Scheduler at" not in scheduler.line():
            pass
        own = ("--host", "127.0.0.1", "--no-nanny", "--nthreads", "1", "--no-dashboard")
        workers = [start("worker", address, *own) for _ in range(2)]
        for worker in workers:
            while "Registered to" not in worker.line():
                pass
        yield address, workers
    finally:
        for process in reversed(started):
            process.kill()


def rosld(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [*map(str, arguments)])


def test_what_a_cluster_makes_of_which_a_worker_dies_is_what_one_process_makes(
    runs: Path, s3: str, cluster: tuple[str, list[Process]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosld.server.cli.lift._PART_MESSAGES", 1000)
    assert rosld("lift", runs, "-o", tmp_path / "here.nq.gz").exit_code == 0
    address, workers = cluster
    manifest = tmp_path / ".there.nq.gz.parts" / "manifest.jsonl"
    is_over = threading.Event()

    def kill() -> None:
        while not is_over.wait(0.01):
            if manifest.exists() and b'"part"' in manifest.read_bytes():
                workers[0].kill()
                return

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        result = rosld("lift", s3, "-o", tmp_path / "there.nq.gz", "--dask", address)
    finally:
        is_over.set()
        killer.join()
    assert result.exit_code == 0, result.output
    assert workers[0].process.poll() is not None
    assert (tmp_path / "there.nq.gz").read_bytes() == (tmp_path / "here.nq.gz").read_bytes()
    result = rosld("export", f"{s3}/old.bag", f"{s3}/folder", "-o", tmp_path / "tables", "--dask", address)
    assert result.exit_code == 0, result.output
    assert len(parquet.read_table(tmp_path / "tables", columns=["index"])) == 2 * 5 * 74


def test_a_url_is_read_without_a_cluster_and_what_is_not_there_is_said(s3: str, runs: Path, tmp_path: Path) -> None:
    for name in ("old.bag", "base.db3"):
        assert rosld("lift", f"{s3}/{name}", "-o", tmp_path / "there.nq").exit_code == 0
        assert rosld("lift", (runs / name).as_uri(), "-o", tmp_path / "here.nq").exit_code == 0
        assert (tmp_path / "there.nq").read_bytes() == (tmp_path / "here.nq").read_bytes()
    result = rosld("lift", "s3://fleet/tuesday", "-o", tmp_path / "x.nq")
    assert result.exit_code == 3
    assert "s3://fleet/tuesday" in result.stderr
