"""Rows are counted in the bytes of every format, whatever the values hold and wherever the chunks are cut."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal, QueryResultsFormat, RdfFormat, Store

from rosld.server.http.problem import Problem
from rosld.server.sparql.results import SOLUTIONS
from rosld.server.sparql.row_limit import RowCounter, limit_rows

PIECES = ["{", "}", ",", '"', "\\", "\n", "\r", "{}", ",{", "},{", ",{}", "a", "<result>", '"bindings":[{', "\u00e9"]
TEXTS = st.lists(st.sampled_from(PIECES), max_size=8).map("".join)
CELLS = st.none() | TEXTS
ROWS = st.lists(st.tuples(CELLS, CELLS), max_size=12)


def written(found: list[tuple[str | None, str | None]], syntax: QueryResultsFormat) -> bytes:
    terms = [["UNDEF" if cell is None else str(Literal(cell)) for cell in row] for row in found]
    values = " ".join(f"({' '.join(row)})" for row in terms)
    results = Store().query(f"SELECT ?a ?b {{ VALUES (?a ?b) {{ {values} }} }}")
    text = results.serialize(format=syntax)  # type: ignore[union-attr, call-arg]
    assert text is not None
    return text


def passes(text: bytes, media_type: str, limit: int, size: int, *, graph: bool = False) -> bool:
    """Whether a text goes by, in chunks of a size, with nothing lost."""
    output = io.BytesIO()
    counting = limit_rows(output, media_type, graph, limit)
    try:
        for at in range(0, len(text), size):
            counting.write(text[at : at + size])
    except Problem as problem:
        if (problem.status, problem.extra) != (503, {"reason": "rows"}):
            raise
        return False
    assert output.getvalue() == text
    return True


@given(found=ROWS)
@pytest.mark.parametrize("media_type", SOLUTIONS)
def test_as_many_rows_as_may_be_pass_and_one_more_does_not(
    media_type: str, found: list[tuple[str | None, str | None]]
) -> None:
    text = written(found, SOLUTIONS[media_type])
    for size in (8192,) if "json" in media_type else (5, 64, 8192):
        assert passes(text, media_type, len(found), size)
        if len(found) > 1:
            assert not passes(text, media_type, len(found) - 1, size)


@pytest.mark.parametrize("media_type", SOLUTIONS)
def test_rows_are_counted_from_the_first_also_where_counting_began_late(media_type: str) -> None:
    text = written([("a" * 50, None)] * 100_000, SOLUTIONS[media_type])
    assert passes(text, media_type, 100_000, 8192)
    assert not passes(text, media_type, 99_999, 8192)


@pytest.mark.parametrize("media_type", ["application/n-triples", "application/n-quads"])
def test_triples_in_lines_are_counted(media_type: str) -> None:
    results = Store().query('CONSTRUCT { <h:a> <h:b> ?x } WHERE { VALUES ?x { 1 2 "a\\nb" } }')
    text = results.serialize(format=RdfFormat.from_media_type(media_type))  # type: ignore[union-attr, call-arg]
    assert text is not None
    assert passes(text, media_type, 3, 4, graph=True)
    assert not passes(text, media_type, 2, 4, graph=True)


def test_what_is_made_one_by_one_is_counted_one_by_one() -> None:
    looks: list[int] = []
    count = RowCounter(lambda: looks.append(1), 2)
    count.count()
    count.count()
    with pytest.raises(Problem):
        count.count()
    assert len(looks) == 3
