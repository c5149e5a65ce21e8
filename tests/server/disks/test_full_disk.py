"""A full disk: stored data is served, no acknowledged write is lost, and writes succeed again once there is room."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.server.disks.server import Server, server_on

pytestmark = pytest.mark.slow

TURTLE = {"Content-Type": "text/turtle"}
BINARY = {"Content-Type": "application/octet-stream"}
NTRIPLES = {"Accept": "application/n-triples"}
MEGABYTES = 16


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small separate file system."""
    if os.getuid() != 0:
        pytest.skip("only root mounts a small file system")
    place = tmp_path / "disk"
    place.mkdir()
    mounting = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={MEGABYTES}m", "tmpfs", str(place)], capture_output=True, text=True
    )
    if mounting.returncode:
        pytest.skip(f"a small file system cannot be mounted here: {mounting.stderr.strip()}")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.fixture
def server(disk: Path, tmp_path: Path) -> Iterator[Server]:
    with server_on(disk / "data", tmp_path / "log", forked=True) as served:
        served.start()
        yield served


def said(number: int, size: int = 100_000) -> str:
    return f'<> <http://example.org/p> "{number} {"x" * size}" .'


def filled(server: Server) -> list[str]:
    """Create resources, documents and files, until the disk is full twice; return those created."""
    made, refused = list[str](), 0
    while refused < 3:
        path, large = f"/data/{len(made)}", refused == 0
        if (len(made) + refused) % 2:
            answer = server.http.put(path, content=b"x" * (500_000 if large else 2000), headers=BINARY)
        else:
            answer = server.http.put(path, content=said(len(made), 100_000 if large else 1000), headers=TURTLE)
        if answer.status_code == 507:
            refused += 1
            continue
        assert answer.status_code == 201, answer.text
        made.append(path)
    return made


def crammed(disk: Path) -> None:
    """Fill the disk completely."""
    with (disk / "others").open("ab", buffering=0) as file:
        for size in (100_000, 4096, 1):
            while True:
                try:
                    file.write(bytes(size))
                except OSError:
                    break


def test_a_full_disk_serves_what_is_there_also_after_a_kill_and_goes_on_once_there_is_room(
    server: Server, disk: Path
) -> None:
    made = filled(server)
    crammed(disk)
    assert "The data disk is full" in server.http.get("/", headers={"Accept": "text/html"}).text
    assert "storageProblem" in server.http.get("/status", headers={"Accept": "text/turtle"}).text
    server.kill()
    crammed(disk)
    server.start()
    assert "The data disk is full" in server.log.read_text()
    assert all(server.http.get(path).status_code == 200 for path in made)
    crammed(disk)  # the start may have freed space, and the log has some
    assert server.http.put("/data/new", content=said(0, 6_000_000), headers=TURTLE).status_code == 507
    subprocess.run(["mount", "-o", f"remount,size={MEGABYTES + 4}m", str(disk)], check=True)
    for path in made[:5]:
        assert server.http.delete(path).status_code == 204
        assert server.http.get(path).status_code in (404, 410)
    assert server.http.put("/data/new", content=said(0), headers=TURTLE).status_code == 201
    server.kill()
    server.start()
    assert all(server.http.get(path).status_code == 200 for path in made[5:])
    assert all(server.http.get(path).status_code in (404, 410) for path in made[:5])
    assert server.http.get("/data/new", headers=NTRIPLES).text.count("x" * 100_000) == 1
    assert server.stop() == 0


def test_receipts_of_a_full_disk_are_kept_in_memory_and_written_when_there_is_room(server: Server, disk: Path) -> None:
    crammed(disk)
    assert server.http.put("/data/one", content=said(1), headers=TURTLE).status_code == 507
    server.kill()
    crammed(disk)
    server.start()
    refused = server.http.put("/data/two", content=said(2), headers=TURTLE)
    assert refused.status_code == 507
    (disk / "others").unlink()
    written = server.http.put("/data/three", content=said(3), headers=TURTLE)
    assert written.status_code == 201
    assert server.stop() == 0
    server.start()
    for answer in (refused, written):
        receipt = answer.links["http://www.w3.org/ns/prov#has_provenance"]["url"]
        assert server.http.get(receipt).status_code == 200
    assert "storageProblem" not in server.http.get("/", headers={"Accept": "text/turtle"}).text


def test_a_folder_that_was_never_served_is_refused_on_a_full_disk_with_words(disk: Path, tmp_path: Path) -> None:
    crammed(disk)
    with server_on(disk / "data", tmp_path / "log", forked=True) as server:
        with pytest.raises(AssertionError):
            server.start()
        assert "No space left" in server.log.read_text() or "full" in server.log.read_text()
