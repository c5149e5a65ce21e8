"""The ontology checked by ROBOT: OWL 2's profiles by the OWL API, consistency by HermiT, and its own list of errors."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest
from pyoxigraph import Literal, Triple

from rosld.ontology.modules import MODULES, OWN, module_path
from rosld.ontology.vocab import xsd
from tests.crawl.robots import ROBOTS
from tests.crawl.site import site
from tests.interop.ontology.robot import catalog, robot, write_alone, write_merged
from tests.ontology.reasoning import of_triples, ontologies
from tests.ontology.test_consistency import told, triples

FILES = Path(__file__).parents[3] / "ontology"
MISTAKE = '<urn:goal> ros:goalId "a" , "b" .'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("robot")


@pytest.fixture(scope="module")
def outcomes(folder: Path) -> Mapping[tuple[str, str], str]:
    """The errors by check and module."""
    commands = {}
    for name in MODULES:
        (folder / name).mkdir()
        alone = write_alone(name, folder / name)
        first, second = (
            ("validate-profile", "--profile", profile, "--output", folder / name / profile) for profile in ("DL", "RL")
        )
        commands["profile", name] = (*first, "--input", alone, *second)
        report = ("--fail-on", "none", "--output", folder / name / "report.tsv")
        commands["report", name] = ("report", "--input", alone, *report)
    imports = ("merge", "--catalog", catalog(folder))
    for name in MODULES:
        commands["merge", name] = (*imports, "--input", FILES / module_path(name), "--output", folder / "merged.ttl")
    found = robot(list(commands.values()))
    return dict(zip(commands, found, strict=True))


def test_every_module_by_itself_is_in_owl_2_dl_and_rl(outcomes: Mapping[tuple[str, str], str], folder: Path) -> None:
    for name in MODULES:
        reports = [(folder / name / profile).read_text() for profile in ("DL", "RL")]
        assert outcomes["profile", name] == "", reports
        assert all("in profile" in report for report in reports), reports


def test_a_module_loads_with_all_that_it_imports(outcomes: Mapping[tuple[str, str], str]) -> None:
    assert {name: outcomes["merge", name] for name in MODULES if outcomes["merge", name]} == {}


def test_the_report_finds_no_error(outcomes: Mapping[tuple[str, str], str], folder: Path) -> None:
    for name in OWN:
        assert outcomes["report", name] == ""
        with (folder / name / "report.tsv").open(newline="") as file:
            errors = [row for row in csv.DictReader(file, delimiter="\t") if row["Level"] == "ERROR"]
        assert errors == [], name


def without_braces(triple: Triple) -> Triple:
    """Encode the braces of a URI template: XSD 1.1 takes any text as xsd:anyURI, HermiT only a URI."""
    value = triple.object
    if isinstance(value, Literal) and value.datatype == xsd.anyURI:
        encoded = value.value.replace("{", "%7B").replace("}", "%7D")
        return Triple(triple.subject, triple.predicate, Literal(encoded, datatype=xsd.anyURI))
    return triple


def reason(said: Iterable[Triple], folder: Path) -> str:
    """Return HermiT's explanation why the ontologies and these triples are inconsistent, or an empty string."""
    merged, why = write_merged(ontologies() + of_triples(map(without_braces, said)), folder), folder / "why.md"
    reasoner = ("--reasoner", "hermit", "--input", merged)
    (outcome,) = robot([("reason", *reasoner, "--output", folder / "reasoned.ttl")])
    if outcome:
        robot([("explain", *reasoner, "--mode", "inconsistency", "--explanation", why)])
    return outcome + (why.read_text() if why.exists() else "")


@pytest.mark.ros2
def test_what_the_robots_say_is_consistent(tmp_path: Path) -> None:
    assert reason([triple for name in ROBOTS for triple in told(site(name), 1)], tmp_path) == ""


def test_a_mistake_is_found(tmp_path: Path) -> None:
    found = reason(triples(MISTAKE), tmp_path)
    assert "inconsistent" in found
    assert "goalId" in found, found
