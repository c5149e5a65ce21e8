"""The steps of a stop as a table: what each does, how many subscribers it reached, and its outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.outline import Statements, outline
from rosld.ontology.vocab import rdfs, ros
from rosld.server.html.labels import label
from rosld.server.html.page import Term
from rosld.server.html.site import Anchor, Site
from rosld.server.html.view import escape_controls

_TONES = {ros.Succeeded: "good", ros.Failed: "error", ros.Running: "warning"}


@dataclass(frozen=True, slots=True)
class StepRow:
    """A step: what it does, what that is about, how many subscribers got it (empty: none is told), what became of it.

    `tone` is "good", "warning", "error", or empty for what has not been done.
    """

    does: str
    anchor: Anchor | None
    subscribers: str
    outcome: str
    words: str
    tone: str


@dataclass(frozen=True, slots=True)
class StopSteps:
    """The table: what was done, or before a stop what would be."""

    title: str
    rows: tuple[StepRow, ...]


def stop_steps(document: Document, site: Site) -> StopSteps | None:
    """The steps that a document tells of, None where it tells of none."""
    subjects = outline(document.triples).subjects
    own = subjects.get(NamedNode(document.url), {})
    steps = [term for term in own.get(ros.stopStep, ()) if isinstance(term, NamedNode)]
    if not steps:
        return None
    is_stopped = _text(own.get(ros.stopped, ())) == "true"
    rows = tuple(_row(subjects.get(step, {}), site) for step in steps)
    return StopSteps("What was told" if is_stopped else "What a stop tells", rows)


def _row(said: Statements, site: Site) -> StepRow:
    state = next((term for term in said.get(ros.state, ()) if isinstance(term, NamedNode)), ros.NotSent)
    about = next((term for term in said.get(ros.touches, ()) if isinstance(term, NamedNode)), None)
    words, subscribers = escape_controls(_text(said.get(ros.words, ()))), _text(said.get(ros.subscriberCount, ()))
    tone = _TONES.get(state, "")
    return StepRow(
        escape_controls(_text(said.get(rdfs.label, ()))),
        None if about is None else site.anchor(about.value),
        subscribers,
        "" if state == ros.NotSent else label(state.value),
        words,
        "warning" if tone == "good" and words and subscribers else tone,  # a subscriber that was not reached
    )


def _text(terms: Sequence[Term]) -> str:
    return next((term.value for term in terms if isinstance(term, Literal)), "")
