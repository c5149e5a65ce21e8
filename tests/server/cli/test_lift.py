"""`rosld lift`: a whole recording as RDF."""

from __future__ import annotations

import gzip
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pyoxigraph import CanonicalizationAlgorithm, Dataset, Quad, RdfFormat, parse
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.base import AdapterOptions
from rosld.ontology.lift import LiftSettings
from rosld.ontology.serialize import serialize_named
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.cli.list_types import open_source
from rosld.server.cli.main import main
from rosld.server.cli.rdf_writer import Lifting, writer

STORE = get_typestore(Stores.ROS1_NOETIC)
BASE = "http://127.0.0.1:8080/"
FORMATS = {"nq": RdfFormat.N_QUADS, "nt": RdfFormat.N_TRIPLES, "ttl": RdfFormat.TURTLE, "trig": RdfFormat.TRIG}
MESSAGES = 12


def markers(number: int) -> object:
    """Return a message with a list of messages, an array of numbers and awkward strings."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        seq=number, stamp=types["builtin_interfaces/msg/Time"](sec=number, nanosec=5), frame_id='a"b\n<é>'
    )
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=float(number), y=float("nan"), z=float("-inf")),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=-0.0, z=0.0, w=1.0),
    )
    return types["geometry_msgs/msg/PoseArray"](header=header, poses=[pose] * (number % 3))


def record(path: Path, messages: int = MESSAGES) -> Path:
    """Write a recording of two readable topics and one whose bytes are no message."""
    strings = STORE.types["std_msgs/msg/String"]
    with BagWriter(path) as bag:
        definition, md5 = STORE.generate_msgdef("geometry_msgs/msg/PoseArray")
        poses = bag.add_connection(
            "/poses", "geometry_msgs/msg/PoseArray", msgdef=definition, md5sum=md5, callerid="/a"
        )
        definition, md5 = STORE.generate_msgdef("std_msgs/msg/String")
        words = bag.add_connection("/words", "std_msgs/msg/String", msgdef=definition, md5sum=md5, callerid="/b")
        broken = bag.add_connection("/broken", "std_msgs/msg/String", msgdef=definition, md5sum=md5, callerid="/b")
        for number in range(messages):
            time = 1_700_000_000_000_000_000 + number * 1_234_567_891
            if number % 3 == 0:
                bag.write(poses, time, STORE.serialize_ros1(markers(number), "geometry_msgs/msg/PoseArray"))
            elif number % 6 == 1:
                bag.write(broken, time, b"\xff\xff\xff\xff")
            else:
                bag.write(words, time, STORE.serialize_ros1(strings(data=f"no {number}"), "std_msgs/msg/String"))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("bag") / "a run.bag")


@pytest.fixture(scope="module")
def lifting(bag: Path) -> Iterator[Lifting]:
    with open_source(f"recording:{bag}", AdapterOptions()) as adapter:
        (recording,) = adapter.recordings.values()
        yield Lifting(recording, Space(BASE), LiftSettings(), simulated_time=False)


def lift(bag: Path, output: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["lift", str(bag), "-o", str(output), *arguments])


def lifted(bag: Path, output: Path, *arguments: str) -> list[Quad]:
    """Return the statements that the command wrote."""
    result = lift(bag, output, *arguments)
    assert result.exit_code == 0, result.output
    plain = gzip.decompress(output.read_bytes()) if output.suffix == ".gz" else output.read_bytes()
    return list(parse(plain, format=FORMATS[output.name.removesuffix(".gz").rpartition(".")[2]]))


def canonical(quads: list[Quad]) -> set[str]:
    """Return the triples without graphs, with canonical blank nodes."""
    dataset = Dataset(Quad(quad.subject, quad.predicate, quad.object) for quad in quads)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(map(str, dataset))


def test_every_syntax_says_the_same_in_several_parts(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rosld.server.cli.parts.BLOCK_MESSAGES", 2)
    monkeypatch.setattr("rosld.server.cli.lift._PART_MESSAGES", 4)
    found = {ending: canonical(lifted(bag, tmp_path / f"x.{ending}")) for ending in FORMATS}
    assert len(found["nq"]) > 200
    assert all(one == found["nq"] for one in found.values())


def test_each_message_has_its_own_url_and_graph_below_the_base_url(bag: Path, tmp_path: Path) -> None:
    base = "https://data.example/robots/"
    for ending, arguments in (("nq", ["--base-url", base.removesuffix("/")]), ("trig", [])):
        graphs = {str(quad.graph_name) for quad in lifted(bag, tmp_path / f"x.{ending}", *arguments)}
        begin = base if arguments else BASE
        messages = {f"<{begin}bags/a%20run/messages/{index}>" for index in range(MESSAGES)}
        assert messages | {f"<{begin}bags/a%20run/>"} <= graphs
        assert all(graph.startswith(f"<{begin}") for graph in graphs)


def test_the_recording_its_topics_and_its_types_are_described(bag: Path, tmp_path: Path) -> None:
    told = canonical(lifted(bag, tmp_path / "x.nt"))
    assert any("<https://w3id.org/rosld#Bag>" in triple for triple in told)
    assert any('"/poses"' in triple for triple in told)
    assert any("types/geometry_msgs/msg/PoseArray#poses>" in triple and "#fieldType" in triple for triple in told)


def test_a_compressed_file_holds_the_same_bytes_and_always_the_same(bag: Path, tmp_path: Path) -> None:
    for name in ("x.nq", "x.nq.gz", "y.nq.gz"):
        assert lift(bag, tmp_path / name).exit_code == 0
    assert gzip.decompress((tmp_path / "x.nq.gz").read_bytes()) == (tmp_path / "x.nq").read_bytes()
    assert gzip.decompress((tmp_path / "y.nq.gz").read_bytes()) == (tmp_path / "x.nq").read_bytes()


def test_what_cannot_be_read_is_told_of_in_the_file_and_on_stderr(bag: Path, tmp_path: Path) -> None:
    result = lift(bag, tmp_path / "x.nt")
    assert result.exit_code == 0
    assert result.stdout == ""
    assert "2 messages" in result.stderr
    assert "/broken" in result.stderr
    assert (tmp_path / "x.nt").read_text().count("<https://w3id.org/rosld#unreadable>") >= 2


def test_the_lines_of_a_message_are_those_of_its_document(lifting: Lifting) -> None:
    lines = writer(Syntax.N_QUADS, lifting)
    for told in lifting.messages():
        assert lines.message(told) == serialize_named(lifting.document(told), Syntax.N_QUADS)


def test_a_large_array_is_elided_above_the_limit_only(bag: Path, tmp_path: Path) -> None:
    elided = f"{rdf.type} {ros.Elided}"
    assert not any(elided in triple for triple in canonical(lifted(bag, tmp_path / "x.nt")))
    assert any(elided in triple for triple in canonical(lifted(bag, tmp_path / "x.nt", "--inline-limit", "3")))


def test_a_name_that_says_no_syntax_and_what_is_missing_are_refused_in_one_line(bag: Path, tmp_path: Path) -> None:
    for name in ("x", "x.csv", "x.gz", "x.nq.zip", "nq"):
        result = lift(bag, tmp_path / name)
        assert (result.exit_code, result.stderr.count("\n"), ".trig" in result.stderr) == (2, 1, True), name
    assert not list(tmp_path.iterdir())
    (tmp_path / "x.nq").write_text("as it was")
    result = lift(tmp_path / "no-such.bag", tmp_path / "x.nq")
    assert (result.exit_code, result.stderr.count("\n"), "no-such.bag" in result.stderr) == (3, 1, True)
    assert (tmp_path / "x.nq").read_text() == "as it was"
    result = lift(bag, tmp_path / "none" / "x.nq")
    assert result.exit_code == 5
    assert result.stderr.splitlines()[-1].startswith("rosld: ")
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_a_run_that_is_ended_leaves_the_output_as_it_was_and_the_same_command_continues(tmp_path: Path) -> None:
    long = record(tmp_path / "long.bag", 30_000)
    output = tmp_path / "out"
    output.mkdir()
    (output / "x.nt.gz").write_text("as it was")
    command = [sys.executable, "-m", "rosld", "lift", str(long), "-o", str(output / "x.nt.gz"), "--workers", "1"]
    manifest = output / ".x.nt.gz.parts" / "manifest.jsonl"
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            while not (manifest.exists() and b"joined" in manifest.read_bytes()) and process.poll() is None:
                time.sleep(0.005)
            process.send_signal(signal.SIGTERM)
            code = process.wait(60)
        finally:
            process.kill()
    assert code == 128 + signal.SIGTERM
    assert (output / "x.nt.gz").read_text() == "as it was"
    assert lift(long, output / "x.nt.gz").exit_code == 0
    assert (
        gzip.decompress((output / "x.nt.gz").read_bytes()).count(f"{ros.received} ".encode()) == 25_000
    )  # one of six is no message
    assert [path.name for path in output.iterdir()] == ["x.nt.gz"]
