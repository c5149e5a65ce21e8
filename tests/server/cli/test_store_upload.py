"""`rosld lift --into`: recordings sent to a store that is busy, away, or refuses them."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pyoxigraph import RdfFormat, parse

from rosld.server.cli.main import main
from tests.runs import write_run
from tests.server.dataset.conftest import Behaviour, Failing, failing

__all__ = ["failing"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("run") / "run.mcap", seconds=2)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that notes what was sent; parts of 60 messages, blocks of 20, no pauses."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("rosld.server.cli.parts.BLOCK_MESSAGES", 20)
    monkeypatch.setattr("rosld.server.cli.lift._PART_MESSAGES", 60)
    monkeypatch.setattr("rosld.server.cli.store_upload._LONGEST_PAUSE", 0)
    return tmp_path / "rosld"


def lift(run: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["lift", str(run), *arguments])


def test_requests_are_repeated_until_the_store_is_ready(
    run: Path, state: Path, failing: Callable[[Behaviour], Failing]
) -> None:
    def busy(server: Failing, connection: socket.socket, body: bytes) -> bool:
        if len(server.bodies) % 3 == 1:
            return server.answer(connection, "503 Service Unavailable")
        return len(server.bodies) % 3 != 2 and server.answer(connection, "204 No Content")

    store = failing(busy)
    result = lift(run, "--into", store.url)
    assert result.exit_code == 0, result.output
    assert len(store.bodies) % 3 == 0
    assert store.bodies[0] == store.bodies[1] == store.bodies[2] != store.bodies[3]
    quads = [quad for body in store.bodies for quad in parse(body, format=RdfFormat.N_QUADS)]
    assert "_:" not in {str(quad.subject)[:2] for quad in quads}
    assert any("/.well-known/genid/l" in str(quad.subject) for quad in quads)
    assert not list(state.iterdir())


def test_what_was_refused_is_sent_by_the_same_command_and_nothing_else(
    run: Path, failing: Callable[[Behaviour], Failing]
) -> None:
    refused: list[bytes] = []

    def strict(server: Failing, connection: socket.socket, body: bytes) -> bool:
        if len(server.bodies) != 5:
            return server.answer(connection, "204 No Content")
        refused.append(body)
        return server.answer(connection, "400 Bad Request", b"too many dots")

    store = failing(strict)
    result = lift(run, "--into", store.url)
    assert result.exit_code == 6
    assert "too many dots" in result.stderr
    sent = list(store.bodies)
    again = lift(run, "--into", store.url)
    assert again.exit_code == 0, again.output
    more = store.bodies[len(sent) :]
    assert more[0] == refused[0]
    assert len(more) == 3
    assert not set(more[1:]) & set(sent)


def test_one_graph_and_credentials_are_sent_as_the_protocol_says_and_stored_nowhere(
    run: Path, state: Path, failing: Callable[[Behaviour], Failing]
) -> None:
    def refuses(server: Failing, connection: socket.socket, body: bytes) -> bool:
        return server.answer(connection, "403 Forbidden")

    store = failing(refuses)
    url = store.url.replace("127.0.0.1", "anna:p%40ss@127.0.0.1")
    result = lift(run, "--into", url, "--graph", "http://example.org/a b")
    assert b"POST /sparql?graph=http%3A%2F%2Fexample.org%2Fa%20b HTTP/1.1\r\n" in store.heads[0]
    assert b"Authorization: Basic YW5uYTpwQHNz\r\n" in store.heads[0]
    assert b"application/n-triples" in store.heads[0]
    assert list(parse(store.bodies[0], format=RdfFormat.N_TRIPLES))
    told = result.output + "".join(path.read_text() for path in state.rglob("manifest.jsonl"))
    assert "p@ss" not in told
    assert "YW5uYTpwQHNz" not in told
    lift(run, "--into", store.url, "--token", "s3cret")
    assert b"Authorization: Bearer s3cret\r\n" in store.heads[-1]


def test_a_place_that_is_no_store_and_two_outputs_are_wrong_usage(run: Path, tmp_path: Path) -> None:
    for arguments in (["--into", "ftp://x/"], ["--into", "http://x/", "-o", str(tmp_path / "x.nq")], []):
        assert lift(run, *arguments).exit_code == 2, arguments
