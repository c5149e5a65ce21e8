"""`rosld check`: what it finds on this machine, in recordings and at robots, and its exit codes."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterable
from contextlib import closing
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from rosld.adapters.base import AdapterOptions, Finding
from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.ros1 import diagnosis as ros1
from rosld.adapters.ros2 import diagnosis as ros2
from rosld.server.cli import data_folder
from rosld.server.cli.check import stamp_ns
from rosld.server.cli.main import main
from tests.adapters.recording.recorder import lines, write_rosbag1
from tests.adapters.ros1.system import free_port, running

Found = list[dict[str, str]]


def check(*arguments: str, code: int) -> Found:
    """Return the findings, after checking the exit code."""
    result = CliRunner().invoke(main, ["check", *arguments, "--json", "--port", "0"])
    assert result.exit_code == code, result.output
    told = json.loads(result.stdout)
    assert told["exitCode"] == code
    findings: Found = told["findings"]
    assert all(each["level"] in ("ok", "warning", "error") for each in findings)
    return findings


def of(findings: Found, subject: str) -> list[tuple[str, str]]:
    """Return the levels and texts of the findings about a subject."""
    return [(each["level"], each["text"]) for each in findings if each["subject"] == subject]


def test_all_is_well_with_a_robot_that_is_there() -> None:
    found = check("rover", code=0)
    assert {each["level"] for each in found} == {"ok"}
    assert of(found, "source")[0][1].startswith("rover: 1 node, ")
    assert of(found, "clock")[0][1].startswith("stamps are 0.")
    text = CliRunner().invoke(main, ["check", "rover", "--port", "0"]).stdout
    assert text.startswith("ok       address  127.0.0.1:0 is free\n")


def test_what_is_wrong_on_this_machine_has_a_next_step(tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        result = CliRunner().invoke(main, ["check", "aircraft", "--port", str(port)])
    assert result.exit_code == 1
    assert f"error    address  cannot listen on 127.0.0.1:{port}" in result.stdout
    with data_folder.lock(tmp_path):
        level, text = of(check("aircraft", "--data", str(tmp_path), code=1), "data")[0]
        assert (level, f"{tmp_path} is served by another rosld (process {os.getpid()})") == ("error", text)
    data_folder.bind_base(tmp_path, "http://other.example/")
    before = {each: each.stat().st_mtime_ns for each in tmp_path.iterdir()}
    base = ("--base-url", "http://robot.example/")
    found = check("aircraft", "--data", str(tmp_path), *base, code=1)
    assert of(found, "data")[0] == ("error", f"{tmp_path} belongs to http://other.example/, not http://robot.example/")
    assert {each: each.stat().st_mtime_ns for each in tmp_path.iterdir()} == before
    missing = tmp_path / "new" / "folder"
    assert of(check("aircraft", "--data", str(missing), *base, code=0), "data")[0][0] == "ok"
    assert not missing.exists()
    file = tmp_path / "file"
    file.write_text("[[rule]]\nnonsense = 1\n", "utf-8")
    found = check("aircraft", "--auth", str(file), "--data", str(file / "below"), code=1)
    assert [each[0][0] for each in (of(found, "auth"), of(found, "data"))] == ["error", "error"]


@pytest.mark.parametrize(("days", "level", "code"), [(-1, "error", 1), (5, "warning", 0), (300, "ok", 0)])
def test_a_certificate_that_expired_or_soon_will_is_reported(tmp_path: Path, days: int, level: str, code: int) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "robot.example")])
    end = datetime.now(timezone.utc) + timedelta(days=days)
    builder = x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
    signed = builder.not_valid_before(end - timedelta(days=9)).not_valid_after(end).sign(key, hashes.SHA256())
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    file = tmp_path / "robot.pem"
    file.write_bytes(signed.public_bytes(pem) + private)
    assert of(check("aircraft", "--tls-cert", str(file), code=code), "certificate")[0][0] == level


def test_without_a_source_only_the_file_is_checked(tmp_path: Path) -> None:
    file = tmp_path / "rosld.toml"
    file.write_text('source = "ros1://nowhere.invalid"\nport = 1\n', "utf-8")
    result = CliRunner().invoke(main, ["check", "--config", str(file)])
    assert (result.exit_code, result.stdout) == (0, "ok  the settings are valid\n")
    file.write_text("port = true\n", "utf-8")
    result = CliRunner().invoke(main, ["check", "--config", str(file)])
    assert (result.exit_code, "rosld.toml:1:8: port must be" in result.stderr) == (2, True)
    assert CliRunner().invoke(main, ["check"]).exit_code == 2


def test_defects_of_recordings_are_warnings_and_unreadable_ones_errors(tmp_path: Path) -> None:
    whole = write_rosbag1(tmp_path / "run.bag", lines(count=2000), chunk=1000)
    assert {each["level"] for each in check(str(whole), code=0)} == {"ok"}
    part = tmp_path / "part.bag"
    part.write_bytes(whole.read_bytes()[:-9000])
    levels = [level for level, _ in of(check(str(part), code=0), "recording")]
    assert "warning" in levels
    (tmp_path / "junk.bag").write_bytes(b"junk")
    found = check(str(tmp_path), code=0)
    assert any("junk.bag cannot be read" in text for _, text in of(found, "recording"))
    assert of(check(str(tmp_path / "junk.bag"), code=3), "source")[0][0] == "error"
    assert of(check(str(tmp_path / "none.bag"), code=3), "source")[0][0] == "error"


def test_a_master_that_does_not_answer_or_has_no_address_is_an_error() -> None:
    found = check(f"ros1://127.0.0.1:{free_port()}", code=4)
    assert of(found, "source")[0][0] == "error"
    found = check("ros1://nowhere.invalid", code=4)
    assert of(found, "master")[-1][1].startswith("the host name nowhere.invalid of the master does not resolve")
    environment = {"ROS_HOSTNAME": "localhost"}
    (finding,) = [each for each in diagnosed("ros1://192.0.2.1", environment) if each.subject in ("address", "network")]
    assert "on the robot is the robot itself" in finding.text or "there is no route" in finding.text


def diagnosed(source: str, environment: dict[str, str]) -> Iterable[Finding]:
    return ros1.diagnose(source, AdapterOptions(), None, environment)


@pytest.mark.slow
def test_nodes_of_ros_1_that_do_not_answer_and_types_that_conflict_are_listed(tmp_path: Path) -> None:
    with running(tmp_path) as ros:
        ros.node("speaking_node.py", "speaker", "/confused", "std_msgs/String", "data: one")
        ros.node("speaking_node.py", "other", "/confused", "std_msgs/Int32", "data: 2")
        ros.node("speaking_node.py", "lost", "/lost", "std_msgs/String", "data: 1", ROS_HOSTNAME="nowhere.invalid")
        ros.node("speaking_node.py", "dead", "/late", "std_msgs/String", "data: 1").kill()
        before = ros.publishers("/confused")
        found = check(ros.source, code=0)
        assert ros.publishers("/confused") == before
    told = [text for _, text in of(found, "node")]
    assert any(text.startswith("the host name nowhere.invalid of /lost does not resolve") for text in told), told
    assert any(text.startswith("/dead does not answer") for text in told), told
    assert any(text.startswith("/confused has several types") for _, text in of(found, "types")), found


@pytest.mark.skipif("ROSLD_ROS2_PYTHON" in os.environ, reason="this Python has rclpy")
def test_ros_2_without_rclpy_is_an_error_that_says_how_to_get_it() -> None:
    level, text = of(check("ros2:", code=1), "source")[0]
    assert (level, "rclpy" in text) == ("error", True)


def test_variables_and_shared_memory_that_keep_nodes_of_ros_2_apart_are_warnings(tmp_path: Path) -> None:
    levels = [each.level for each in ros2.range_findings({"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.5"})]
    assert levels == ["warning", "ok"]
    assert len([*ros2.range_findings({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off", "ROS_LOCALHOST_ONLY": "0"})]) == 1
    segment = tmp_path / "fastrtps_1234"
    segment.write_bytes(b"")
    assert not [*ros2.memory_findings(tmp_path)]
    if os.geteuid() == 0:
        os.chown(segment, 54321, -1)
        (finding,) = ros2.memory_findings(tmp_path)
        assert "the user number 54321" in finding.text


def test_participants_are_heard_in_every_domain() -> None:
    if ros2.multicast_failure() is not None:
        pytest.skip("this machine does not receive its own multicast")
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sock:
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        with ros2.listening() as listener:
            for domain, data in ((201, b"RTPS\2\3"), (202, b"other")):
                sock.sendto(data, ("239.255.0.1", 7400 + 250 * domain))
            heard = listener(0.3)
    assert 201 in heard
    assert 202 not in heard


def test_stamps_are_read_from_both_encodings() -> None:
    seconds = (5).to_bytes(4, "little") + (7).to_bytes(4, "little")
    ref = TypeRef("std_msgs/msg/Header")
    for encoding, data in (
        (Encoding.ROS1, b"\1\0\0\0" + seconds),
        (Encoding.CDR, b"\0\1\0\0" + seconds),
        (Encoding.CDR, b"\0\0\0\0" + seconds[3::-1] + seconds[:3:-1]),
    ):
        assert stamp_ns(Sample(data, encoding, ref, "/a", 0, 1)) == 5_000_000_007
    assert stamp_ns(Sample(b"\0\1", Encoding.CDR, ref, "/a", 0, 1)) == 0
