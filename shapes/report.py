"""Validation reports: why a body was refused, as SHACL says it (SHACL 1.0 section 3.6)."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import Statement, boolean, statements, text, triples_about
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import rdf, ros, sh


def validation_report(url: str, violations: Sequence[Violation], *, node: str = "#message") -> Document:
    """The report on a body sent to `url`: one result a violation.

    What a shape found tells that shape, its constraint, focus node, path and value; all else is about the node of the
    message. The path of a field is also given as text (`linear.x`), because it may lead through several nodes.
    """
    report = NamedNode(f"{url}#report")
    results = [NamedNode(f"{url}#result.{number}") for number in range(len(violations))]
    triples = triples_about(
        report, (rdf.type, sh.ValidationReport), (sh.conforms, boolean(not violations)), *statements(sh.result, results)
    )
    for result, violation in zip(results, violations, strict=True):
        triples += triples_about(
            result,
            (rdf.type, sh.ValidationResult),
            (sh.resultSeverity, violation.severity or sh.Violation),
            (sh.focusNode, violation.focus or NamedNode(url + node)),
            (ros.fieldPath, text(violation.path) if violation.path else None),
            (sh.resultMessage, text(violation.said or violation.message)),
            *_source(violation),
        )
    return Document(url, tuple(triples))


def _source(violation: Violation) -> tuple[Statement, ...]:
    """What broke, and what broke it."""
    return (
        (sh.resultPath, violation.predicate),
        (sh.value, violation.term if violation.term is not None else text(violation.value)),
        (sh.sourceConstraintComponent, violation.component or ros.FieldConstraintComponent),
        (sh.sourceShape, violation.shape),
    )
