"""Stores with a lifted recording, sent by `rosld lift --into` or loaded in bulk, give the answers of a server."""

from __future__ import annotations

import csv
import gzip
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from rosld.server.cli.main import main
from tests.interop.missing import require
from tests.processes import Process
from tests.runs import write_run
from tests.server.dataset.conftest import Oxigraph, free_port, new_oxigraph

__all__ = ["new_oxigraph"]

PREFIXES = """
PREFIX ros: <https://w3id.org/rosld#>
PREFIX battery: <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#>
PREFIX odometry: <https://w3id.org/rosld/types/nav_msgs/msg/Odometry#>
PREFIX with: <https://w3id.org/rosld/types/geometry_msgs/msg/TwistWithCovariance#>
PREFIX twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#>
PREFIX vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#>
PREFIX header: <https://w3id.org/rosld/types/std_msgs/msg/Header#>
PREFIX diagnostics: <https://w3id.org/rosld/types/diagnostic_msgs/msg/DiagnosticArray#>
PREFIX status: <https://w3id.org/rosld/types/diagnostic_msgs/msg/DiagnosticStatus#>
"""
SPEED = "?m odometry:twist/with:twist/twist:linear/vector:x ?x"
STATUS = "?m diagnostics:status/rdf:rest*/rdf:first"
QUERIES = {
    "": ["SELECT ?name ?n { ?b ros:hasRecordedTopic ?t . ?t ros:name ?name ; ros:count ?n }"],
    "battery_state": ["SELECT (MIN(?p) AS ?least) (COUNT(?m) AS ?n) { ?m battery:percentage ?p }"],
    "odom": [
        "SELECT (COUNT(?m) AS ?n) { ?m ros:received ?time }",
        f"SELECT (MAX(?x) AS ?most) (AVG(?x) AS ?mean) {{ {SPEED} }}",
        f"SELECT (COUNT(?m) AS ?n) {{ {SPEED} FILTER(?x > 0.5) }}",
        "SELECT DISTINCT ?frame { ?m odometry:header/header:frame_id ?frame }",
        f"SELECT ?m ?x {{ {SPEED} }} ORDER BY DESC(?x) ?m LIMIT 3",
    ],
    "cmd_vel": ["SELECT (MAX(?x) AS ?most) { ?m twist:linear/vector:x ?x }"],
    "diagnostics": [
        f"SELECT ?name (COUNT(?m) AS ?n) {{ {STATUS}/status:name ?name }} GROUP BY ?name",
        f"SELECT ?level (COUNT(?m) AS ?n) {{ {STATUS}/status:level ?level }} GROUP BY ?level",
    ],
}
"""Questions about messages `?m` of a topic (none: about the recording)."""


def rows(text: str) -> list[tuple[object, ...]]:
    """Return the rows of CSV in a fixed order, with rounded numbers."""
    return sorted((tuple(map(value, row)) for row in list(csv.reader(text.splitlines()))[1:]), key=str)


def value(text: str) -> object:
    try:
        return round(float(text), 5)
    except ValueError:
        return text


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("run") / "run.mcap", seconds=10)


@pytest.fixture(scope="module")
def here(start_server: Callable[..., Any], run: Path) -> tuple[str, dict[str, list[tuple[object, ...]]]]:
    """The base URL of a server with the recording, and its answers."""
    served = start_server(str(run))
    answers = {}
    for topic, queries in QUERIES.items():
        for query in queries:
            past = f"{{ <{served.url}topics/{topic}> ros:past ?m . "
            text = PREFIXES + (query.replace("{ ", past, 1) if topic else query)
            reply = served.http.post("/sparql", data={"query": text}, headers={"Accept": "text/csv"}, timeout=60)
            assert reply.status_code == 200, reply.text
            answers[query] = rows(reply.text)
            assert answers[query], query
    return served.url, answers


@pytest.fixture(scope="module")
def base(here: tuple[str, Any]) -> str:
    return here[0]


def assert_same_answers(here: tuple[str, dict[str, list[tuple[object, ...]]]], ask: Callable[[str], str]) -> None:
    base, answers = here
    for topic, queries in QUERIES.items():
        for query in queries:
            message = f"{{ ?record ros:recordedMessage ?m ; ros:onTopic <{base}topics/{topic}> . "
            text = PREFIXES + "PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#>\n"
            text += query.replace("{ ", message, 1) if topic else query
            assert rows(ask(text)) == answers[query], query


def asked(url: str, **more: str) -> Callable[[str], str]:
    def ask(text: str) -> str:
        reply = httpx.post(url, data={"query": text, **more}, headers={"Accept": "text/csv"}, timeout=60)
        assert reply.status_code == 200, reply.text
        return reply.text

    return ask


def lift(run: Path, base: str, *arguments: str | Path) -> None:
    result = CliRunner().invoke(main, ["lift", str(run), "--base-url", base, *map(str, arguments)])
    assert result.exit_code == 0, result.output


def test_oxigraph_receives_a_recording_and_gives_the_same_answers(
    run: Path, here: Any, base: str, new_oxigraph: Callable[..., Oxigraph], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(run.parent))
    store = new_oxigraph()
    for _ in range(2):  # what is sent again is there already
        lift(run, base, "--into", f"{store.url}/store")
    assert_same_answers(here, asked(f"{store.url}/query", **{"union-default-graph": "true"}))


def test_oxigraph_loads_a_recording_in_bulk(
    run: Path, here: Any, base: str, new_oxigraph: Callable[..., Oxigraph], tmp_path: Path
) -> None:
    lift(run, base, "-o", tmp_path / "run.nq.gz")
    command = [str(Path(sys.executable).with_name("oxigraph")), "load", "--location", str(tmp_path / "store")]
    subprocess.run([*command, "--file", str(tmp_path / "run.nq.gz")], check=True, capture_output=True, timeout=60)
    store = new_oxigraph(tmp_path / "store")
    assert_same_answers(here, asked(f"{store.url}/query", **{"union-default-graph": "true"}))


CONFIGURATION = """
[Database]
DatabaseFile = {folder}/virtuoso.db
ErrorLogFile = {folder}/virtuoso.log
LockFile = {folder}/virtuoso.lck
TransactionFile = {folder}/virtuoso.trx
xa_persistent_file = {folder}/virtuoso.pxa
[TempDatabase]
DatabaseFile = {folder}/temporary.db
TransactionFile = {folder}/temporary.trx
[Parameters]
ServerPort = 127.0.0.1:{sql}
DirsAllowed = {folder}
[HTTPServer]
ServerPort = 127.0.0.1:{http}
ServerRoot = {folder}
"""


@pytest.fixture
def virtuoso(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """The addresses of a Virtuoso that may load files from `tmp_path`: SQL, HTTP."""
    require("virtuoso-t", "isql-vt")
    sql, http = free_port(), free_port()
    (tmp_path / "virtuoso.ini").write_text(CONFIGURATION.format(folder=tmp_path, sql=sql, http=http))
    command = ["virtuoso-t", "+foreground", "+configfile", str(tmp_path / "virtuoso.ini")]
    process = Process(command, os.environ, grace=30, patience=60)
    try:
        while "HTTP server online" not in process.line():
            pass
        yield f"127.0.0.1:{sql}", f"http://127.0.0.1:{http}"
    finally:
        process.stop()


def test_virtuoso_loads_a_recording_in_bulk(
    run: Path, here: Any, base: str, virtuoso: tuple[str, str], tmp_path: Path
) -> None:
    lift(run, base, "-o", tmp_path / "all.nq")
    kept = [line for line in (tmp_path / "all.nq").read_bytes().splitlines(keepends=True) if b"wktLiteral>" not in line]
    (tmp_path / "run.nq.gz").write_bytes(gzip.compress(b"".join(kept)))
    sql, http = virtuoso
    load = f"exec=ld_dir('{tmp_path}', '*.nq.gz', ''); rdf_loader_run(); SELECT ll_error FROM DB.DBA.load_list;"
    done = subprocess.run(["isql-vt", sql, "dba", "dba", load], capture_output=True, text=True, timeout=60, check=True)
    assert "NULL" in done.stdout, done.stdout
    assert_same_answers(here, asked(f"{http}/sparql"))
