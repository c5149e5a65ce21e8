"""Reports of rejected bodies in SHACL."""

from __future__ import annotations

import rdflib
from pyoxigraph import Literal, NamedNode
from rdflib.namespace import RDF, SH

from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import sh
from rosld.server.http.problem_details import validation_report

URL = "http://127.0.0.1:8080/topics/cmd_vel"
VIOLATIONS = [Violation("linear.x", "expected a float64", '"fast"'), Violation("", "the message is missing", None)]


def test_a_report_has_everything_that_shacl_demands_of_one() -> None:
    graph = rdflib.Graph().parse(serialize(validation_report(URL, VIOLATIONS), Syntax.TURTLE), format="turtle")
    (report,) = graph.subjects(RDF.type, SH.ValidationReport)
    assert graph.value(report, SH.conforms).toPython() is False  # type: ignore[union-attr]
    results = list(graph.objects(report, SH.result))
    assert len(results) == 2
    for result in results:
        for required in (SH.focusNode, SH.resultSeverity, SH.sourceConstraintComponent):
            assert len(list(graph.objects(result, required))) == 1


def test_what_a_shape_found_is_told_with_its_shape_constraint_path_and_value() -> None:
    focus, shape, path = (NamedNode(f"http://h/{name}") for name in ("engine", "mapping#standing", "v#speed"))
    component, value = NamedNode(sh.iri + "MaxInclusiveConstraintComponent"), Literal(5)
    found = Violation("speed", "must be at most 0", "5", component, shape, focus, path, value, sh.Warning)
    triples = validation_report(URL, [found]).triples
    said = {t.predicate: t.object for t in triples if t.subject == NamedNode(f"{URL}#result.0")}
    assert said[sh.sourceConstraintComponent] == component
    assert (said[sh.sourceShape], said[sh.focusNode], said[sh.resultPath]) == (shape, focus, path)
    assert (said[sh.value], said[sh.resultSeverity]) == (value, sh.Warning)


def test_hostile_words_are_literals_in_every_syntax() -> None:
    hostile = Violation('a"b', "\x00<script>", "\ud800")
    for syntax in (Syntax.TURTLE, Syntax.JSON_LD, Syntax.N_TRIPLES):
        assert serialize(validation_report(URL, [hostile]), syntax)
