"""Pages for people: every resource as HTML, drawn on the server, with forms where something can be done.

Nothing here knows a robot or a store: a `Page` (or one of its kin) goes in, bytes come out. Whatever came from a robot
is text to these pages, never markup, and `HEADERS` tells the browser to run nothing at all.
"""

from rosld.server.html.forms import (
    DeleteForm,
    Form,
    MessageForm,
    ParameterForm,
)
from rosld.server.html.page import (
    ALTERNATES,
    Alternate,
    Count,
    EntryPage,
    Listing,
    Notice,
    Page,
    ProblemPage,
    QueryPage,
    QueryParameter,
    Results,
    SparqlPage,
    Step,
    StoredQuery,
)
from rosld.server.html.reading import parse_form, parse_parameter, split_hidden
from rosld.server.html.render import (
    CONTENT_SECURITY_POLICY,
    HEADERS,
    ICON,
    STYLESHEET,
    render_entry,
    render_page,
    render_problem,
    render_query,
    render_sparql,
)
from rosld.server.html.site import Site

__all__ = [
    "ALTERNATES",
    "CONTENT_SECURITY_POLICY",
    "HEADERS",
    "ICON",
    "STYLESHEET",
    "Alternate",
    "Count",
    "DeleteForm",
    "EntryPage",
    "Form",
    "Listing",
    "MessageForm",
    "Notice",
    "Page",
    "ParameterForm",
    "ProblemPage",
    "QueryPage",
    "QueryParameter",
    "Results",
    "Site",
    "SparqlPage",
    "Step",
    "StoredQuery",
    "parse_form",
    "parse_parameter",
    "render_entry",
    "render_page",
    "render_problem",
    "render_query",
    "render_sparql",
    "split_hidden",
]
