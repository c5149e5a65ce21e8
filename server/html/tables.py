"""Results of queries as tables, cut where they get too large for a page."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

from pyoxigraph import Literal

from rosld.server.html.page import PageResults, Term
from rosld.server.html.site import Site
from rosld.server.html.terms import cell_view, term_view
from rosld.server.html.view import View, escape_controls


@dataclass(frozen=True, slots=True)
class ResultsTable:
    """Rows of views under headings; `cut` says that there were more rows than are shown."""

    columns: tuple[str, ...]
    rows: tuple[tuple[View | None, ...], ...]
    is_truncated: bool = False
    boolean: bool | None = None
    note: str = ""


def results_table(results: PageResults, site: Site) -> ResultsTable:
    """The table of a query's results: at most `results.limit` rows are read and shown."""
    columns = tuple(escape_controls(name) for name in results.variables)
    if results.boolean is not None:
        return ResultsTable(columns, (), boolean=results.boolean, note=results.note)
    taken = list(islice(results.rows, results.limit + 1))
    rows = tuple(tuple(_view(term, site) for term in row) for row in taken[: results.limit])
    return ResultsTable(columns, rows, is_truncated=len(taken) > results.limit, note=results.note)


def _view(term: Term | None, site: Site) -> View | None:
    if term is None:
        return None
    return cell_view(term, site) if isinstance(term, Literal) else term_view(term, site)
