"""A disk that fails to sync: no write is acknowledged that may not be stored."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.server.disks.server import Server, server_on

pytestmark = pytest.mark.slow

TURTLE, FILE = {"Content-Type": "text/turtle"}, {"Content-Type": "application/octet-stream"}
COUNT = "SELECT (COUNT(*) AS ?n) WHERE { GRAPH ?g { ?s <http://example.org/p> ?o } }"


@pytest.fixture(scope="session")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library that makes syncs fail."""
    if shutil.which("gcc") is None:
        pytest.skip("without gcc: apt-get install --no-install-recommends gcc libc6-dev")
    library = tmp_path_factory.mktemp("shim") / "failing.so"
    source = Path(__file__).with_name("failing.c")
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True)
    return library


class Disk:
    """Control of a disk: how many syncs fail, and of which files."""

    def __init__(self, control: Path) -> None:
        self._control = control
        self.fail(0, "none")

    def fail(self, times: int, of: str) -> None:
        self._control.write_text(f"{times:<9} {of}")

    @property
    def failures_left(self) -> int:
        return int(self._control.read_text().split()[0])


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    return Disk(tmp_path / "control")


@pytest.fixture
def server(tmp_path: Path, shim: Path, disk: Disk) -> Iterator[Server]:
    environment = {"LD_PRELOAD": str(shim), "SYNC_FAILS": str(tmp_path / "control")}
    with server_on(tmp_path / "data", tmp_path / "log", environment) as served:
        served.start()
        yield served


def put(server: Server, name: str, value: str = "x") -> int:
    body = f'<> <http://example.org/p> "{value}" .'
    return server.http.put(f"/data/{name}", content=body, headers=TURTLE).status_code


def value(server: Server, name: str) -> str | None:
    answer = server.http.get(f"/data/{name}", headers={"Accept": "application/n-triples"})
    if answer.status_code == 404:
        return None
    assert answer.status_code == 200, answer.text
    (line,) = [line for line in answer.text.splitlines() if "example.org" in line]
    return line.split('"')[1]


def counted(server: Server) -> int:
    answer = server.http.get("/sparql", params={"query": COUNT}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return int(answer.text.split()[1])


def test_a_file_whose_sync_fails_is_not_there_and_after_a_document_nothing_is_written_until_the_next_start(
    server: Server, disk: Disk
) -> None:
    disk.fail(1, "/blobs/")
    assert server.http.put("/data/file", content=b"bytes", headers=FILE).status_code == 503
    assert server.http.get("/data/file").status_code == 404
    assert server.http.put("/data/file", content=b"bytes", headers=FILE).status_code == 201
    assert put(server, "old") == 201
    assert counted(server) == 1
    disk.fail(1, "records.sqlite")
    assert put(server, "new") == 507
    assert disk.failures_left == 0
    refused = server.http.put("/data/more", content="<> <http://example.org/p> 1 .", headers=TURTLE)
    assert refused.status_code == 507
    assert "restart rosld" in refused.json()["detail"]
    assert "retry-after" not in refused.headers
    assert server.http.delete("/data/old").status_code == 507
    assert (value(server, "old"), value(server, "new"), value(server, "more")) == ("x", None, None)
    assert counted(server) == 1
    assert "storageProblem" in server.http.get("/", headers={"Accept": "text/turtle"}).text
    assert server.stop() == 0
    server.start()
    assert (value(server, "old"), value(server, "more")) == ("x", None)
    assert put(server, "more") == 201
    assert "storageProblem" not in server.http.get("/", headers={"Accept": "text/turtle"}).text
