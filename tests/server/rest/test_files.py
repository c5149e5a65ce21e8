"""Files, on the real server: whole, in ranges, and to readers that disconnect (LDP 4.4, RFC 9110 14, RFC 6266)."""

from __future__ import annotations

import asyncio
import gc
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.rest import responses
from rosld.server.rest.responses import CHUNK, exact_media_type, file_response
from tests.server.http.listening import exchange, listening

TAG = '"kept-7.any"'
LARGE = bytes(range(256)) * 1024 * 5  # 10 chunks
HUGE = 64 * 1024 * 1024


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    body: bytes


def app(path: Path, size: int, media_type: str = "image/png", name: str | None = None) -> ASGIApp:
    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        asked = Request(scope).headers
        try:
            response = await file_response(
                path, size, media_type, TAG, headers={"vary": "Accept"}, name=name, range_=asked.get("range"),
                if_range=asked.get("if-range"), head=scope["method"] == "HEAD",
            )  # fmt: skip
        except Problem as problem:
            response = render(problem).response()
        await response(scope, receive, send)

    return answer


def asked(method: str, headers: Mapping[str, str]) -> bytes:
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"{method} / HTTP/1.1\r\nHost: h\r\nConnection: close\r\n{lines}\r\n".encode()


def read(served: ASGIApp, method: str = "GET", **headers: str) -> Answer:
    async def talk() -> bytes:
        async with listening(served) as port:
            return await exchange(port, asked(method, {name.replace("_", "-"): each for name, each in headers.items()}))

    head, _, body = asyncio.run(talk()).partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    pairs = (line.partition(": ") for line in lines)
    return Answer(int(first.split()[1]), {name.lower(): value for name, _, value in pairs}, body)


@pytest.fixture
def large(tmp_path: Path) -> Path:
    path = tmp_path / "large"
    path.write_bytes(LARGE)
    return path


def test_a_range_within_or_across_chunks_is_sent_alone(large: Path) -> None:
    for start, stop in ((CHUNK - 5, CHUNK + 5), (len(LARGE) - 1, None)):
        end = len(LARGE) if stop is None else stop
        answer = read(app(large, len(LARGE)), range=f"bytes={start}-{'' if stop is None else stop - 1}", if_range=TAG)
        assert (answer.status, answer.body) == (206, LARGE[start:end])
        assert answer.headers["content-range"] == f"bytes {start}-{end - 1}/{len(LARGE)}"
        assert answer.headers["content-type"] == "image/png"
        assert answer.headers["etag"] == TAG


# Interpretation by browsers


@pytest.mark.slow
def test_no_script_in_a_stored_page_or_drawing_runs_in_the_name_of_this_server(tmp_path: Path) -> None:
    for media_type in ("text/html", "image/svg+xml", "application/xhtml+xml"):
        path = tmp_path / "page"
        path.write_bytes(b"<script>alert(document.domain)</script>")
        for method, headers in (("GET", {}), ("GET", {"range": "bytes=0-9"}), ("HEAD", {})):
            answer = read(app(path, 39, media_type), method, **headers)
            policy = [part.strip().split() for part in answer.headers["content-security-policy"].split(";")]
            assert ["sandbox"] in policy  # alone: no other header relaxes it
            assert ["default-src", "'none'"] in policy
            assert not [part for part in policy if part[0].startswith("script-src")]
            assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.slow
def test_a_file_is_saved_under_its_name(tmp_path: Path) -> None:
    for name, media_type, disposition in (
        (None, "image/png", "inline"),
        ("map.png", "image/png", 'inline; filename="map.png"'),
        ("my map.png", "image/png", 'inline; filename="my map.png"'),
        ("plan.pdf", "application/pdf", 'attachment; filename="plan.pdf"'),
        ("plan.pdf", "Application/PDF; v=1", 'attachment; filename="plan.pdf"'),
        ("höhe.png", "image/png", "inline; filename=\"h_he.png\"; filename*=UTF-8''h%C3%B6he.png"),
        ('a"b\\c\r\nX: y', "image/png", "inline; filename=\"a_b_c__X_ y\"; filename*=UTF-8''a%22b%5Cc%0D%0AX%3A%20y"),
        ("\ud800", "image/png", "inline; filename=\"_\"; filename*=UTF-8''%3F"),
    ):
        path = tmp_path / "blob"
        path.write_bytes(b"x")
        assert read(app(path, 1, media_type, name), "HEAD").headers["content-disposition"] == disposition


def test_what_is_no_media_type_is_refused() -> None:
    for stated in ("", "text", "text/plain\r\nX: y", "tèxt/plain", 'a/b; c="d\x00"', "a/b, c/d", "/"):
        with pytest.raises(Problem) as refused:
            exact_media_type(stated)
        assert refused.value.status == 415


# Readers, files and memory


def open_files(path: Path) -> int:
    """Return the number of open descriptors of a file in this process."""
    gc.collect()
    here = Path("/proc/self/fd")
    return sum(1 for each in here.iterdir() if _target(each) == str(path))


def _target(link: Path) -> str:
    try:
        return str(link.readlink()).removesuffix(" (deleted)")
    except OSError:
        return ""


@pytest.fixture
def huge(tmp_path: Path) -> Path:
    path = tmp_path / "huge"
    with path.open("wb") as file:
        file.truncate(HUGE)
    return path


async def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition holds that no event reports; the server of each test ends within its own time."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.01)


@pytest.mark.slow
async def test_a_reader_who_leaves_closes_the_file(huge: Path) -> None:
    async with listening(app(huge, HUGE)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(asked("GET", {}))
        await reader.readexactly(100_000)
        assert open_files(huge) == 1
        writer.close()
        await until(lambda: open_files(huge) == 0)


@pytest.mark.slow
async def test_a_reader_who_takes_nothing_more_is_taken_for_gone(huge: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(responses, "READ_TIMEOUT", 0.2)
    async with listening(app(huge, HUGE)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(asked("GET", {}))
        await reader.readexactly(1000)
        await until(lambda: open_files(huge) == 0)
        writer.transport.abort()


@pytest.mark.slow
async def test_what_is_removed_while_it_is_read_is_still_sent_whole(huge: Path) -> None:
    async with listening(app(huge, HUGE)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(asked("GET", {}))
        await reader.readuntil(b"\r\n\r\n")
        await asyncio.to_thread(huge.unlink)
        size = 0
        while chunk := await reader.read(1 << 20):
            size += len(chunk)
        writer.close()
    assert size == HUGE


@pytest.mark.slow
async def test_many_readers_of_a_large_file_take_little_memory(huge: Path) -> None:
    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    async with listening(app(huge, HUGE)) as port:
        before = resident()
        readers = [await asyncio.open_connection("127.0.0.1", port, limit=4096) for _ in range(40)]
        for _, writer in readers:
            writer.write(asked("GET", {}))
        for reader, _ in readers:
            await reader.readexactly(4096)
        await until(lambda: open_files(huge) == 40)
        assert resident() - before < 40 * 1024 * 1024
        for _, writer in readers:
            writer.transport.abort()


def test_a_file_that_is_not_there_is_told_before_anything_is_sent(tmp_path: Path) -> None:
    for size in (10, HUGE):
        with pytest.raises(FileNotFoundError):
            asyncio.run(file_response(tmp_path / "nothing", size, "a/b", TAG, headers={}))
