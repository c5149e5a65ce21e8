"""nginx with `docs/how-to/nginx.conf`, and curl in front of it: requests pass, whatever upgrades they request."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.server.auth.test_proxy import free_port, listening, nginx

TURTLE = ("-H", "Content-Type: text/turtle")
CODE = ("-o", "/dev/null", "-w", "%{http_code}")
H2C = (
    "-H",
    "Connection: Upgrade, HTTP2-Settings",
    "-H",
    "Upgrade: h2c",
    "-H",
    "HTTP2-Settings: AAMAAABkAAQAoAAAAAIAAAAA",
)


@pytest.fixture(scope="module")
def proxy(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The URL of the aircraft behind nginx, and the certificate to trust."""
    folder: Path = tmp_path_factory.mktemp("nginx")
    port = free_port()
    served = start_server("aircraft", "--base-url", f"https://localhost:{port}/", process=True)
    (address,) = listening(served.process.pid)
    with nginx(folder, port, address.rpartition(":")[2]):
        yield f"https://localhost:{port}/", str(folder / "cert.pem")


@pytest.fixture(params=[(), ("--http1.1",), H2C], ids=["default", "http1.1", "h2c"])
def through(request: pytest.FixtureRequest, proxy: tuple[str, str]) -> tuple[str, ...]:
    """Return the options of curl: its version of HTTP, and its trusted certificate."""
    return ("--cacert", proxy[1], *request.param)


def test_bodies_of_known_length_and_in_chunks_arrive(
    curl: Callable[..., str], proxy: tuple[str, str], through: tuple[str, ...], request: pytest.FixtureRequest
) -> None:
    url = f"{proxy[0]}data/{request.node.callspec.id}"
    assert curl(*through, *CODE, *TURTLE, "-X", "PUT", "-d", "<> <urn:p> 1 .", url) == "201"
    assert curl(*through, *CODE, *TURTLE, "-T", "-", url, given="<> <urn:p> 'in chunks' .") == "204"
    read = curl(*through, "-H", "Accept: application/n-triples", url)
    assert f'<{url}> <urn:p> "in chunks"' in read


def test_updates_and_queries_pass(curl: Callable[..., str], proxy: tuple[str, str], through: tuple[str, ...]) -> None:
    update = f"update=INSERT DATA {{ GRAPH <{proxy[0]}data/updated> {{ <urn:s> <urn:p> 'x' }} }}"
    assert curl(*through, *CODE, "--data-urlencode", update, f"{proxy[0]}sparql") == "204"
    ask = f"query=ASK {{ GRAPH <{proxy[0]}data/updated> {{ <urn:s> <urn:p> 'x' }} }}"
    assert curl(*through, "-H", "Accept: text/csv", "--data-urlencode", ask, f"{proxy[0]}sparql").split() == [
        "_askResult",
        "true",
    ]


def test_a_name_with_encoded_slashes_stays_one_name(
    curl: Callable[..., str], proxy: tuple[str, str], through: tuple[str, ...], request: pytest.FixtureRequest
) -> None:
    url = f"{proxy[0]}data/a%2Fb-{request.node.callspec.id}"
    assert curl(*through, *CODE, *TURTLE, "-X", "PUT", "-d", "", url) == "201"
    assert url in curl(*through, "-H", "Accept: text/turtle", f"{proxy[0]}data/")
