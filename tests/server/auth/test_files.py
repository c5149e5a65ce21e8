"""The file of --auth, in both forms, and the commands that write it; TLS."""

from __future__ import annotations

import datetime
import re
import ssl
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from rosld.server.auth import config
from rosld.server.auth.rules import Mode
from rosld.server.auth.tokens import generate_token, parse_credentials, token_digest
from rosld.server.cli.main import main
from tests.server.conftest import Served

BASE = "http://robot.example/"
TOML = f"""
[[agent]]
name = "anna"
webid = "https://anna.example/#me"
[[token]]
agent = "anna"
sha256 = "{token_digest("a")}"
[[rule]]
agents = ["anna", "authenticated"]
modes = ["read", "control"]
paths = ["/topics/camera/**"]
types = ["sensor_msgs/*"]
deny = true
"""
TURTLE = f"""
@prefix acl: <http://www.w3.org/ns/auth/acl#> . @prefix ros: <https://w3id.org/rosld#> .
@prefix foaf: <http://xmlns.com/foaf/0.1/> .
<https://anna.example/#me> a foaf:Agent ; ros:name "anna" ; ros:tokenDigest "{token_digest("a")}" .
[] a acl:Authorization ; acl:agent <https://anna.example/#me> ; acl:agentClass acl:AuthenticatedAgent ;
   acl:mode acl:Read, ros:Command ; acl:default </topics/camera> ; ros:typeGlob "sensor_msgs/*" ; ros:deny true .
"""


def test_both_forms_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(TOML)
    (tmp_path / "a.ttl").write_text(TURTLE)
    one, other = config.read_config(tmp_path / "a.toml", BASE), config.read_config(tmp_path / "a.ttl", BASE)
    assert one.policy == other.policy
    assert one.tokens.owner_of("a") == other.tokens.owner_of("a") == "anna"
    assert one.tokens.owner_of("b") is None


def test_what_is_not_understood_is_refused_at_the_start_in_a_sentence(tmp_path: Path) -> None:
    for text, words in (
        ("[[rule]]\nagents = ['a']\nmodes = ['read']\n", "rule 1 has no paths|rule 1: paths"),
        ("[[rule]]\nagents = ['a']\nmodes = ['fly']\npaths = ['/']", "rule 1: 'fly' is not a mode; choose from read"),
        ("[[rule]]\nagents = ['a']\nmodes = ['read']\npaths = ['topics']", "rule 1: 'topics' must begin"),
        ("[[rule]]\nagents = ['a']\nmodes = ['read']\npaths = ['/']\nallow = 1", "rule 1: unknown key 'allow'"),
        ("[[token]]\nagent = 'a'\nsha256 = 'plain'", "token 1: 'plain'... is not the SHA-256"),
        ("[[token]]\nagent = 'anybody'\nsha256 = 'x'", "token 1: 'anybody' is not a valid agent name"),
        ("[[issuer]]\nurl = 'http://evil.example'\naudience = 'x'", "is not an https URL"),
        ("[[issuer]]\nurl = 'https://i.example'\naudience = 'x'\nalgorithms = ['HS256']", "'HS256' is not supported"),
        ("[[issuer]]\nurl = 'https://i.example'\naudience = 'x'\nalgorithms = ['none']", "'none' is not supported"),
        ("[[user]]\nname = 'x'", "unknown table 'user'; choose from"),
        ("rule = 3", "unknown table 'rule'"),
        ("[[rule", "auth.toml: "),
    ):
        file = tmp_path / "auth.toml"
        file.write_text(text)
        with pytest.raises(ValueError, match=words):
            config.read_config(file, BASE)
        told = CliRunner().invoke(main, ["serve", "aircraft", "--port", "0", "--auth", str(file)])
        assert told.exit_code == 1
        assert "Traceback" not in told.output


def test_turtle_that_is_not_understood_is_refused(tmp_path: Path) -> None:
    for line in (
        "acl:mode acl:Fly",
        "acl:accessTo <http://elsewhere.example/>",
        "acl:agentClass acl:Nobody",
        "acl:origin <x:y>",
        'acl:agent "anna"',
    ):
        file = tmp_path / "a.ttl"
        file.write_text(TURTLE.replace("ros:deny true", f"ros:deny true ; {line}"))
        with pytest.raises(ValueError, match=re.escape(str(file))):
            config.read_config(file, BASE)


def test_tokens_are_made_listed_and_taken_away(tmp_path: Path) -> None:
    file = tmp_path / "auth.toml"

    def run(*arguments: str) -> str:
        result = CliRunner().invoke(main, ["token", *arguments, "--file", str(file)])
        assert result.exit_code == 0, result.output
        return result.stdout

    token = run("add", "anna", "--mode", "read", "--glob", "/topics/**").strip()
    run("add", "bert")
    run("add", "anna")
    found = config.read_config(file, BASE)
    assert found.tokens.owner_of(token) == "anna"
    assert token not in file.read_text()
    assert file.stat().st_mode & 0o077 == 0
    assert found.policy.rights_of(found.policy.agents["anna"]).may(Mode.READ, ("topics", "x"))
    assert run("list") == "anna\t2\nbert\t1\n"
    run("remove", "anna")
    assert run("list") == "bert\t1\n"
    assert config.read_config(file, BASE).tokens.owner_of(token) is None


def test_a_token_has_256_bits_and_is_found_by_its_digest_alone() -> None:
    one, other = generate_token(), generate_token()
    assert one != other
    assert len(one.removeprefix("rosld_")) == 43
    sent = parse_credentials(f"Bearer {one}")
    assert sent is not None
    assert sent.token == one


def certificate(folder: Path) -> tuple[Path, Path]:
    """Create a self-signed certificate for 127.0.0.1, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "localhost")])
    now = datetime.datetime.now(datetime.timezone.utc)
    names = x509.SubjectAlternativeName([x509.DNSName("localhost")])
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(names, critical=False)
        .sign(key, hashes.SHA256())
    )
    cert, private = folder / "cert.pem", folder / "key.pem"
    cert.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    private.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return cert, private


def test_it_speaks_tls_by_itself(serve: Callable[..., Served], tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    served = serve("aircraft", "--tls-cert", str(cert), "--tls-key", str(key))
    assert served.url.startswith("https://127.0.0.1:")
    port = served.url.rstrip("/").rpartition(":")[2]
    trusted = ssl.create_default_context(cafile=str(cert))
    with httpx.Client(verify=trusted, base_url=f"https://localhost:{port}") as client:
        assert client.get("/").status_code == 200
        posted = client.post("/services/aircraft/start", headers={"Origin": f"https://localhost:{port}"})
        assert posted.status_code == 201


def test_a_certificate_that_does_not_fit_is_refused_at_the_start(tmp_path: Path) -> None:
    cert, _ = certificate(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    _, key = certificate(other)
    told = CliRunner().invoke(
        main, ["serve", "aircraft", "--port", "0", "--tls-cert", str(cert), "--tls-key", str(key)]
    )
    assert told.exit_code == 1
    assert "in PEM" in told.output
    assert "needs a certificate" in CliRunner().invoke(main, ["serve", "aircraft", "--tls-key", str(key)]).output
