"""Sources of bridges: TLS with a certification authority of one's own, and credentials, which are shown to nobody."""

from __future__ import annotations

import asyncio
import base64
import datetime
import json
import logging
import ssl
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from websockets.asyncio.server import serve

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Live, Stale
from rosld.adapters.registry import adapter_for
from rosld.adapters.rover import rover_adapter
from rosld.server.cli.main import main
from tests.adapters.ros1.system import free_port
from tests.adapters.rosbridge.bridge import Bridge
from tests.adapters.session import opened_on

BASIC = "Basic " + base64.b64encode(b"ada:p@ss").decode()
SCHEMES = ("rosbridge", "foxglove")


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ssl.SSLContext]:
    """A file with the certificate of an authority, and the TLS of a server for localhost that it has certified."""
    folder, now = tmp_path_factory.mktemp("tls"), datetime.datetime.now(datetime.timezone.utc)
    own_key, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    issuer, name = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, each)]) for each in ("lab", "localhost"))
    usage = dict.fromkeys(("digital_signature", "content_commitment", "key_encipherment", "data_encipherment",
                           "key_agreement", "crl_sign", "encipher_only", "decipher_only"), False)  # fmt: skip

    def certificate(subject: x509.Name, public: Any, *extensions: tuple[x509.ExtensionType, bool]) -> bytes:
        day = datetime.timedelta(days=1)
        builder = x509.CertificateBuilder(issuer, subject, public, x509.random_serial_number(), now - day, now + day)
        for extension, critical in extensions:
            builder = builder.add_extension(extension, critical)
        return builder.sign(own_key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)

    known = x509.SubjectKeyIdentifier.from_public_key(own_key.public_key())
    trusted, cert, private = (folder / each for each in ("authority.pem", "cert.pem", "key.pem"))
    constraints = x509.BasicConstraints(ca=True, path_length=None), True
    signs = x509.KeyUsage(**usage, key_cert_sign=True), True
    trusted.write_bytes(certificate(issuer, own_key.public_key(), constraints, signs, (known, False)))
    by = x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(known), False
    names = x509.SubjectAlternativeName([x509.DNSName("localhost")]), False
    cert.write_bytes(certificate(name, key.public_key(), names, by))
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    private.write_bytes(key.private_bytes(serialization.Encoding.PEM, *form))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(cert, private)
    return trusted, context


async def graph_of(source: str) -> Any:
    """Return the graph of a source as soon as it was opened."""
    async with opened_on(adapter_for(source, AdapterOptions())) as session:
        return session.graph


async def test_a_bridge_is_reached_over_tls_if_its_authority_is_trusted(
    authority: tuple[Path, ssl.SSLContext], monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge = Bridge(lambda: rover_adapter("rover", AdapterOptions()), tls=authority[1])
    bridge.start()
    try:
        source = f"rosbridges://localhost:{bridge.port}"
        graph = await graph_of(source)
        assert isinstance(graph.state, Stale)
        assert "certificate" in graph.state.why
        monkeypatch.setenv("SSL_CERT_FILE", str(authority[0]))
        graph = await graph_of(source)
        assert isinstance(graph.state, Live)
        assert "/odom" in graph.topics
    finally:
        bridge.stop()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("user", "header"), [("ada:p%40ss@", BASIC), (":p%40ss@", "Bearer p@ss"), ("", None)])
async def test_credentials_are_sent_and_not_shown(
    scheme: str, user: str, header: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    received: list[str | None] = []

    def refuse(connection: Any, request: Any) -> Any:
        received.append(request.headers.get("Authorization"))
        return connection.respond(401, "no")

    caplog.set_level(logging.DEBUG)
    async with serve(lambda _: asyncio.sleep(0), "localhost", 0, process_request=refuse) as server:
        graph = await graph_of(f"{scheme}://{user}localhost:{server.sockets[0].getsockname()[1]}")
    assert received[0] == header
    assert isinstance(graph.state, Stale)
    assert "401" in graph.state.why
    logged = [each.getMessage() for each in caplog.records if each.name != "websockets.server"]  # the test's own
    for words in (graph.state.why, *logged):
        assert not any(each in words for each in ("ada:", "p@ss", "p%40ss", BASIC.split()[1]))


@pytest.mark.parametrize("scheme", SCHEMES)
async def test_credentials_do_not_follow_a_redirection(scheme: str) -> None:
    received: list[Any] = []
    async with serve(received.append, "localhost", 0) as other:
        place = f"ws://localhost:{other.sockets[0].getsockname()[1]}/"

        def redirect(connection: Any, request: Any) -> Any:
            answer = connection.respond(307, "")
            answer.headers["Location"] = place
            return answer

        async with serve(received.append, "localhost", 0, process_request=redirect) as server:
            graph = await graph_of(f"{scheme}://:secret@localhost:{server.sockets[0].getsockname()[1]}")
    assert "307" in graph.state.why
    assert received == []


def test_the_command_line_does_not_repeat_credentials() -> None:
    source = f"rosbridge://ada:secret@127.0.0.1:{free_port()}"
    for arguments in (["check", source, "--json"], ["check", f"{source}x"], ["serve", source.replace("rosb", "b")]):
        done = CliRunner().invoke(main, arguments)
        assert done.exit_code != 0
        assert "secret" not in done.output
    assert json.loads(CliRunner().invoke(main, ["check", source, "--json"]).stdout)["source"].startswith(
        "rosbridge://1"
    )


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("rest", [":9090", "://h:x", "://h?x=1", "://ada:sec/ret@h", "://h:9090:9090"])
def test_a_source_that_names_no_bridge_is_refused(scheme: str, rest: str) -> None:
    with pytest.raises(ValueError, match=f"write {scheme}://HOST") as refusal:
        adapter_for(f"{scheme}{rest}", AdapterOptions())
    assert "ret" not in str(refusal.value)
