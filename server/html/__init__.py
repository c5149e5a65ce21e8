"""Pages for people: every resource as HTML, drawn on the server, with forms where something can be done.

Nothing here knows a robot or a store: a `Page` (or one of its kin) goes in, bytes come out. Whatever came from a robot
is text to these pages, never markup, and `HEADERS` tells the browser to run nothing but `live.js`, which keeps a page
up to date while it is looked at, and `filter.js`, which finds things on long ones. Without them every page is as whole.
"""

from rosld.server.html.affordances import action_form, forms_of, property_form
from rosld.server.html.form_parser import (
    parse_choice,
    parse_form,
    parse_parameter,
    parse_value,
    split_hidden,
)
from rosld.server.html.forms import (
    ChoiceForm,
    DeleteForm,
    Form,
    MessageForm,
    ParameterForm,
    ValueForm,
)
from rosld.server.html.page import (
    ALTERNATES,
    Alternate,
    Csrf,
    EntryCount,
    EntryPage,
    MemberColumns,
    Notice,
    NoticeLink,
    Offer,
    Page,
    PageResults,
    ProblemPage,
    QueryPage,
    SequenceLink,
    SparqlPage,
    StoredQueryLink,
    StoredQueryParameter,
)
from rosld.server.html.render import (
    CONTENT_SECURITY_POLICY,
    FILTER_SCRIPT,
    HEADERS,
    ICON,
    SCRIPT,
    STYLESHEET,
    prepare_pages,
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
    "FILTER_SCRIPT",
    "HEADERS",
    "ICON",
    "SCRIPT",
    "STYLESHEET",
    "Alternate",
    "ChoiceForm",
    "Csrf",
    "DeleteForm",
    "EntryCount",
    "EntryPage",
    "Form",
    "MemberColumns",
    "MessageForm",
    "Notice",
    "NoticeLink",
    "Offer",
    "Page",
    "PageResults",
    "ParameterForm",
    "ProblemPage",
    "QueryPage",
    "SequenceLink",
    "Site",
    "SparqlPage",
    "StoredQueryLink",
    "StoredQueryParameter",
    "ValueForm",
    "action_form",
    "forms_of",
    "parse_choice",
    "parse_form",
    "parse_parameter",
    "parse_value",
    "prepare_pages",
    "property_form",
    "render_entry",
    "render_page",
    "render_problem",
    "render_query",
    "render_sparql",
    "split_hidden",
]
