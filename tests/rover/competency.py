"""The questions of docs/reference/questions.md, asked of a robot."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import NamedTuple

import httpx

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "questions.md"
_EXAMPLE = re.compile(r"^\*\*(\d+)\. (.*?)\*\*(.*?)\n\n```sparql\n(.*?)```", re.MULTILINE | re.DOTALL)
_OF_ROS = ("ros:", "w3id.org/rosld")


class Question(NamedTuple):
    """A question: its number, its words, whether it claims to use public terms alone, and its query."""

    number: int
    words: str
    is_public: bool
    query: str

    @property
    def uses_public_terms(self) -> bool:
        return not any(term in self.query for term in _OF_ROS)


def questions() -> list[Question]:
    text = DOCUMENT.read_text(encoding="utf-8")
    return [Question(int(n), words, "public terms" in note, query) for n, words, note, query in _EXAMPLE.findall(text)]


def ask(http: httpx.Client, query: str) -> list[dict[str, str]]:
    """Return the rows of a SELECT."""
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.DictReader(io.StringIO(answer.text)))


def unanswered(http: httpx.Client, without: frozenset[int] = frozenset()) -> dict[str, str]:
    """Return the questions without an answer, except those `without` one on this robot."""
    asked = (one for one in questions() if one.number not in without)
    return {f"{one.number}. {one.words}": one.query for one in asked if not ask(http, one.query)}
