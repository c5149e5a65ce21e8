"""ROBOT, the tool of the OBO Foundry on the OWL API: many commands in one JVM."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from rdflib import OWL, RDF, XSD, Graph, Literal, URIRef

from rosld.ontology.modules import MODULES, module_iri, module_path, served_triples
from tests.interop.java.maven import libraries
from tests.ontology.reasoning import VOCABULARIES

POM, PROGRAM = (Path(__file__).with_name(name) for name in ("pom.xml", "Robot.java"))
PATIENCE = 600.0
_FILES = Path(__file__).parents[3] / "ontology"
_IMPORTED = {
    "http://www.w3.org/ns/prov-o#": "prov",
    "http://www.w3.org/ns/sosa/": "sosa",
    "http://www.w3.org/ns/ssn/": "ssn",
    "http://www.w3.org/ns/ldp": "ldp",
    "https://www.w3.org/2019/wot/td": "td",
    "http://www.ease-crc.org/ont/ROS.owl": "ease",
    "http://www.ease-crc.org/ont/SOMA.owl": "soma",
    "http://purl.org/ieee1872-owl/cora-bare": "cora",
    "http://www.w3.org/ns/dcat": "dcat",
    "http://www.opengis.net/ont/geosparql": "geo",
    "http://qudt.org/schema/qudt/": "qudt",
}
"""The available imported ontologies, by the names of their files."""


def robot(commands: Sequence[Sequence[str | Path]]) -> list[str]:
    """Run commands of ROBOT, and return the error of each, or an empty string.

    A command that ends the process, such as reasoning that finds a contradiction, is the last one.
    """
    java = ["java", "-XX:+UseSerialGC", "-Xmx2g", "-cp", f"{libraries(POM)}/*", str(PROGRAM)]
    lines = "".join("\t".join(map(str, command)) + "\n" for command in commands)
    done = subprocess.run(java, input=lines, capture_output=True, text=True, timeout=PATIENCE, check=False)
    outcomes = done.stdout.splitlines()
    return outcomes if len(outcomes) == len(commands) else [*outcomes, done.stderr[-2000:]]


def write_alone(name: str, folder: Path) -> Path:
    """Write a module as it is served, without its imports."""
    text = "".join(f"{triple} .\n" for triple in served_triples(name))
    graph = Graph().parse(data=text, format="nt")
    graph.remove((None, OWL.imports, None))
    return _write(graph, folder / f"{name}.ttl")


def write_merged(graph: Graph, folder: Path) -> Path:
    """Write ontologies and data as one ontology, without literals of datatypes that OWL 2 lacks."""
    merged = Graph()
    for subject, predicate, value in graph:
        if predicate in (OWL.imports, OWL.versionIRI) or value == OWL.Ontology:
            continue
        datatype = str(value.datatype or XSD.string) if isinstance(value, Literal) else str(XSD.string)
        is_foreign = not datatype.startswith((str(XSD), str(RDF.langString)))
        merged.add((subject, predicate, Literal(str(value)) if is_foreign else value))
    merged.add((URIRef("urn:merged"), RDF.type, OWL.Ontology))
    return _write(merged, folder / "merged.ttl")


def catalog(folder: Path) -> Path:
    """Return an XML catalog (OASIS) of the modules and their imports, for use without a network."""
    here = {module_iri(name): _FILES / module_path(name) for name in MODULES}
    here |= {iri: VOCABULARIES / f"{name}.ttl" for iri, name in _IMPORTED.items()}
    for number, iri in enumerate(sorted(_imports_of_others() - here.keys())):
        here[iri] = folder / f"empty-{number}.ttl"
        here[iri].write_text(f"<{iri}> a <{OWL.Ontology}> .")
    lines = [f'<uri name="{iri}" uri="{path.as_uri()}"/>' for iri, path in here.items()]
    path = folder / "catalog.xml"
    path.write_text(f'<catalog xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">{"".join(lines)}</catalog>')
    return path


def _imports_of_others() -> set[str]:
    """Return the imports of the vocabularies themselves, as far as they are available."""
    graphs = (Graph().parse(path) for path in VOCABULARIES.glob("*.ttl"))
    return {str(each) for graph in graphs for each in graph.objects(None, OWL.imports)}


def _write(graph: Graph, path: Path) -> Path:
    path.write_bytes(graph.serialize(format="turtle", encoding="utf-8"))
    return path
