"""The aircraft with access rules: for anybody, a reader of some topics, a commander, an administrator."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from rosld.server.auth.tokens import token_digest
from tests.server.auth.issuer import Issuer
from tests.server.conftest import Served


def rule(agents: str, modes: str, *paths: str, types: str = "", deny: bool = False) -> str:
    """Return an access rule as TOML; blanks separate agents, modes, paths and types."""
    lists = {"agents": agents.split(), "modes": modes.split(), "paths": " ".join(paths).split(), "types": types.split()}
    lines = [f"{name} = {json.dumps(values)}" for name, values in lists.items() if values]
    return "\n".join(["[[rule]]", *lines, *(["deny = true"] if deny else []), "", ""])


UNHURRIED = ("--setting", "client_rate", "100000")
"""These clients send more requests per second than those of a real robot."""
AGENTS = ("reader", "typist", "commander", "admin")
RULES = (
    rule("anybody", "read", "/", "/style.css", "/icon.svg", "/live.js", "/ontology", "/openapi.json", "/.well-known/**")
    + rule(
        "reader", "read", "/topics/** /sparql /graphs /queries/** /channels/** /data/** /resources/** /parameters/**"
    )
    + rule("reader", "write", "/data/**", "/parameters/**")
    + rule(
        "reader",
        "read write",
        "/topics/cockpit/** /data/secret/** /resources/aircraft/engine/** /parameters/aircraft/**",
        deny=True,
    )
    + rule("typist", "read control", "/topics/**", "/services/**", types="std_msgs/* std_srvs/*")
    + rule("commander", "read control", "/**")
    + rule("admin", "read write control administer", "/**")
)


def token(agent: str) -> str:
    """Return the token of an agent of these tests."""
    return f"token-of-{agent}"


def tokens(*agents: str) -> str:
    """Return the tables with the digests of their tokens."""
    return "".join(f'[[token]]\nagent = "{each}"\nsha256 = "{token_digest(token(each))}"\n' for each in agents)


@dataclass
class Guarded:
    """A server with access rules, their file, and a client for each agent."""

    served: Served
    file: Path
    clients: dict[str, httpx.Client]

    @property
    def url(self) -> str:
        return self.served.url

    def __getitem__(self, agent: str) -> httpx.Client:
        return self.clients[agent]


def clients(url: str, *agents: str) -> dict[str, httpx.Client]:
    """Return a client for each agent, and one for anybody."""
    known = {each: {"Authorization": f"Bearer {token(each)}"} for each in agents}
    return {
        name: httpx.Client(base_url=url, headers=headers, timeout=15)
        for name, headers in {"anybody": {}, **known}.items()
    }


@pytest.fixture(scope="module")
def guard(
    start_server: Callable[..., Served], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Guarded]]:
    """Start the aircraft with these rules."""
    with contextlib.ExitStack() as opened:

        def started(rules: str, *agents: str, options: tuple[str, ...] = ()) -> Guarded:
            file = tmp_path_factory.mktemp("door") / "auth.toml"
            file.write_text(tokens(*agents) + rules)
            served = start_server("aircraft", "--auth", str(file), "--max-publish-rate", "100000", *UNHURRIED, *options)
            found = clients(served.url, *agents)
            for each in found.values():
                opened.enter_context(each)
            return Guarded(served, file, found)

        yield started


@pytest.fixture(scope="module")
def guarded(guard: Callable[..., Guarded]) -> Guarded:
    """The aircraft with the usual agents."""
    found = guard(RULES, *AGENTS)
    for path in ("secret/plan", "open/plan"):
        answer = found["admin"].put(f"/data/{path}", content="<> a <#T>; <#p> </data/secret/plan> .", headers=TURTLE)
        assert answer.status_code == 201, answer.text
    return found


TURTLE = {"Content-Type": "text/turtle"}


@pytest.fixture(scope="module")
def issuer() -> Iterator[Issuer]:
    found = Issuer()
    yield found
    found.server.shutdown()
    found.server.server_close()
