"""The ontology judged by ROBOT: OWL 2's profiles by the OWL API, consistency by HermiT, and its own list of errors."""

from __future__ import annotations

import csv
from contextlib import AbstractContextManager
from pathlib import Path

import httpx
import pytest
from pyoxigraph import Literal, Triple

from rosld.ontology.modules import MODULES, OWN
from rosld.ontology.vocab import xsd
from tests.interop.ontology.robot import catalog, robot, write_alone, write_merged
from tests.ontology import robots
from tests.ontology.reasoning import of_triples, ontologies
from tests.ontology.test_consistency import triples
from tests.ros2.distros import DISTROS

IMPORTING = [name for name in MODULES if name not in ("align-dcat", "align-cora")]
"""Those of which everything that they import is here."""


@pytest.mark.parametrize("name", MODULES)
def test_every_module_by_itself_is_in_owl_2_dl_and_rl(tmp_path: Path, name: str) -> None:
    reports = {profile: tmp_path / f"{profile}.txt" for profile in ("DL", "RL")}
    checks = [("validate-profile", "--profile", profile, "--output", report) for profile, report in reports.items()]
    first, second = checks
    done = robot(*first, "--input", write_alone(name, tmp_path), *second)
    assert done.code == 0, [report.read_text() for report in reports.values() if report.exists()]
    assert all("in profile" in report.read_text() for report in reports.values())


@pytest.mark.parametrize("name", IMPORTING)
def test_a_module_loads_with_all_that_it_imports(tmp_path: Path, name: str) -> None:
    file = Path(__file__).parents[3] / "ontology" / f"{name}.ttl"
    done = robot("merge", "--catalog", catalog(tmp_path), "--input", file, "--output", tmp_path / "merged.ttl")
    assert done.code == 0, done.output


@pytest.mark.parametrize("name", OWN)
def test_the_report_finds_no_error(tmp_path: Path, name: str) -> None:
    report = tmp_path / "report.tsv"
    done = robot("report", "--input", write_alone(name, tmp_path), "--fail-on", "none", "--output", report)
    assert done.code == 0, done.output
    with report.open(newline="") as file:
        errors = [row for row in csv.DictReader(file, delimiter="\t") if row["Level"] == "ERROR"]
    # What replaces a deprecated term is said of it, which the report takes for a use of it.
    assert [row for row in errors if not row["Rule Name"].startswith("deprecated_")] == []


def without_braces(triple: Triple) -> Triple:
    """Encode the braces of a URI template: XSD 1.1 takes any text as xsd:anyURI, HermiT only a URI."""
    value = triple.object
    if isinstance(value, Literal) and value.datatype == xsd.anyURI:
        encoded = value.value.replace("{", "%7B").replace("}", "%7D")
        return Triple(triple.subject, triple.predicate, Literal(encoded, datatype=xsd.anyURI))
    return triple


def judged(data: AbstractContextManager[httpx.Client], folder: Path) -> str:
    """Why the ontologies and all that a robot says are inconsistent, as HermiT explains it; empty if they are not."""
    graph = ontologies()
    with data as http:
        graph += of_triples(map(without_braces, robots.told(http).triples()))
    merged = write_merged(graph, folder)
    done = robot("reason", "--reasoner", "hermit", "--input", merged, "--output", folder / "reasoned.ttl")
    if done.code == 0:
        return ""
    why = folder / "why.md"
    robot("explain", "--reasoner", "hermit", "--input", merged, "--mode", "inconsistency", "--explanation", why)
    return f"{done.output[-2000:]}{why.read_text() if why.exists() else ''}"


def test_what_the_aircraft_says_is_consistent(tmp_path: Path) -> None:
    assert judged(robots.aircraft(), tmp_path) == ""


def test_what_the_rover_says_is_consistent(tmp_path: Path) -> None:
    assert judged(robots.rover(), tmp_path) == ""


def test_what_a_real_ros_1_says_is_consistent(tmp_path: Path) -> None:
    assert judged(robots.a_ros_1(tmp_path), tmp_path) == ""


@pytest.mark.ros2
@pytest.mark.parametrize("distro", DISTROS)
def test_what_a_real_ros_2_says_is_consistent(tmp_path: Path, distro: str) -> None:
    assert judged(robots.a_ros_2(distro), tmp_path) == ""


@pytest.mark.parametrize(
    "mistake",
    [
        "<urn:receipt> a ros:Write ; prov:generated <urn:call> . <urn:call> a ros:Call .",
        "<urn:robot> ros:state ros:Live , ros:Stale .",
        '<urn:topic> ros:rate "often" .',
    ],
)
def test_a_mistake_is_found(tmp_path: Path, mistake: str) -> None:
    graph = ontologies()
    graph += of_triples(triples(mistake))
    done = robot(
        "reason", "--reasoner", "hermit", "--input", write_merged(graph, tmp_path), "--output", tmp_path / "out.ttl"
    )
    assert (done.code, "inconsistent" in done.output) == (1, True), done.output
