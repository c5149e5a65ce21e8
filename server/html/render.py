"""Rendering of pages: one function per kind of page, which fills a template with its values."""

from __future__ import annotations

import json
from collections.abc import Iterator
from urllib.parse import quote

import orjson
from markupsafe import Markup
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.ontology.describe_datasets import structured_data
from rosld.ontology.describe_views import SearchResult
from rosld.ontology.document import Document
from rosld.ontology.modules import home_of_terms, module_url
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.vocab import PREFIXES, ldp, rdf, ros, td
from rosld.server.html.cockpit import LEVELS, CockpitPage, panel_views
from rosld.server.html.cockpit_form import KINDS
from rosld.server.html.description import describe, first_text, group_sections, objects_of
from rosld.server.html.forms import Form
from rosld.server.html.frame import is_refreshed, page_frame, render_template
from rosld.server.html.graphics import frame_row, plot_lines, plot_query, pose_words, space_query
from rosld.server.html.offer import FormTarget, form_targets, offer_view
from rosld.server.html.page import (
    ALTERNATES,
    CLOUD,
    PICTURE_ALTERNATES,
    THING,
    Alternate,
    DiagnosticsPage,
    EntryPage,
    FramesPage,
    GraphPage,
    Notice,
    NoticeLevel,
    Page,
    PlotPage,
    ProblemPage,
    QueryPage,
    SearchPage,
    SpacePage,
    SparqlPage,
)
from rosld.server.html.sections import (
    container_table,
    endpoint_table,
    message_sections,
    parameter_columns,
    parameters_below,
    stop_steps,
)
from rosld.server.html.site import Site, readable_path
from rosld.server.html.values import brief_text, results_table, thumbnail_view
from rosld.server.html.view import escape_controls, time_view
from rosld.server.hypermedia.views import ComplexView, PropertyView
from rosld.server.space.drawing import PLACED_TYPES

_FAILED_GOALS = frozenset({ros.Aborted, ros.Rejected, ros.Lost})
_GOAL_VERBS = {"succeeded": "has", **dict.fromkeys(("accepted", "rejected", "aborted", "canceled", "lost"), "was")}
_CALLS = {
    ros.Running: ("The service has not responded yet", NoticeLevel.INFO),
    ros.Succeeded: ("The service has responded", NoticeLevel.GOOD),
    ros.Failed: ("The call has failed", NoticeLevel.ERROR),
    ros.Refused: ("The call was refused", NoticeLevel.ERROR),
    ros.NotSent: ("The call was not sent", NoticeLevel.ERROR),
    ros.OutcomeUnknown: ("The outcome of the call is unknown", NoticeLevel.ERROR),
}
_NOTICED = (
    (ros.unreachable, "Unreachable"),
    (ros.unreadable, "Unreadable"),
    (ros.uncallable, "Cannot be called"),
    (ros.lifecycleUnknown, "Lifecycle unknown"),
)
_DRAWN = (
    *(ldp.contains, ros.hasEndpoint, ros.stopStep, ros.warning, td.hasActionAffordance, td.hasEventAffordance),
    ros.shape,
)
"""Predicates that a page shows as a table or form, and folds in the list of statements."""
_STEPS = {"first": "First", "prev": "Previous", "next": "Next", "last": "Last", "enclosure": "Download"}
_FORMATS = (
    ("html", "a table on this page"),
    ("json", "JSON"),
    ("csv", "CSV"),
    ("tsv", "TSV"),
    ("xml", "XML"),
    ("ttl", "Turtle (graphs)"),
    ("jsonld", "JSON-LD (graphs)"),
)
_FIRST_QUERY = """PREFIX ros: <{vocabulary}>

SELECT ?topic ?type ?rate WHERE {{
  ?topic a ros:Topic ;
         ros:hasMessageType ?type ;
         ros:rate ?rate .
}}
ORDER BY DESC(?rate)"""


def render_page(page: Page) -> bytes:
    """Return the page of a resource.

    The page has notices, the offer or messages, contents, allowed forms, and all statements.
    """
    posted = form_targets(_fitting(page), page.allow, page.csrf, page.site)
    body = _body(page, posted)
    return render_template(
        "page.html",
        page_frame(page.site, page.title, page.document.url, page.notices + _own_notices(page), is_refreshed(page)),
        page=page,
        drives=_commands_velocity(page.document, page.site),
        forms=[each for each in posted if not (isinstance(page.offer, ComplexView) and each.form.action)],
        formats=[
            replace(each, query=page.query)
            for each in (
                *page.alternates,
                *((THING,) if isinstance(page.offer, ComplexView) else ()),
                *(PICTURE_ALTERNATES if body["has_picture"] else ()),
                *((CLOUD,) if body["has_cloud"] else ()),
            )
        ],
        data=structured_data_script(page.document),
        steps=[(_STEPS.get(step.rel, step.rel), step.rel, page.site.href(step.url)) for step in page.steps],
        curl=_curl(page.document.url.partition("?")[0] + (f"?{page.query}" if page.query else ""), "text/turtle"),
        **body,
    )


def _alternates(url: str, *more: Alternate) -> list[Alternate]:
    """Return the other formats of a page, with the query of its URL."""
    return [replace(each, query=url.partition("?")[2]) for each in (*more, *ALTERNATES)]


def structured_data_script(document: Document) -> Markup | None:
    """Return the JSON-LD in the page that search engines and data loaders read; None if there is none."""
    found = structured_data(document)
    # Without `<`, so that no string ends the script element.
    return None if found is None else Markup(orjson.dumps(found).decode().replace("<", "\\u003c"))


def _commands_velocity(document: Document, site: Site) -> bool:
    """Whether the resource is a topic that takes velocity commands, whose page may get a pad while it is open."""
    types = (term.value for term in objects_of(document, ros.hasMessageType) if isinstance(term, NamedNode))
    return any(type.removeprefix(site.types) in COMMANDS for type in types)


def _fitting(page: Page) -> Iterator[Form]:
    """Return the forms without that of a read-only property, whose offer explains why."""
    locked = isinstance(page.offer, PropertyView) and not page.offer.affordance.write
    return (form for form in page.forms if not (locked and form.method == "PUT"))


def _body(page: Page, posted: tuple[FormTarget, ...]) -> dict[str, object]:
    """Return the part between the heading of a page and its forms."""
    document, site = page.document, page.site
    if page.offer is not None:
        return {
            "offer": offer_view(page.offer, site, posted),
            "has_picture": False,
            "has_motion": False,
            "has_space": False,
            "has_cloud": False,
            "messages": (),
            "asides": (),
            "contents": None,
            "sections": (),
            "groups": (),
            "endpoints": None,
            "told": None,
            "folded": describe(document, site),
        }
    messages = message_sections(document, site, page.query)
    own = {each.predicate for each in document.triples if each.subject == NamedNode(document.url)}
    left = own.intersection(_DRAWN[1:])
    parameters = parameter_columns(document, page.listing)
    apart = () if parameters is None else parameters_below(document)
    sections = describe(document, site, without=_DRAWN, apart=apart)
    groups = group_sections(sections[1:])
    return {
        "offer": None,
        "has_picture": any(each.picture is not None and not each.picture.refused for each in messages),
        "has_motion": any(each.picture is not None and each.picture.motion for each in messages),
        "has_space": any(each.space and each.picture is None for each in messages),
        "has_cloud": any(each.is_cloud for each in messages),
        "messages": [each for each in messages if not each.aside],
        "asides": [each for each in messages if each.aside],
        "contents": container_table(document, site, parameters or page.listing),
        "sections": sections[:1] if groups else sections,
        "groups": groups,
        "endpoints": endpoint_table(document, site),
        "told": stop_steps(document, site),
        "folded": describe(document, site, without=own - left) if left else (),
    }


def _own_notices(page: Page) -> tuple[Notice, ...]:
    """Return notices of problems in the description itself, except those of offers."""
    if page.offer is not None:
        return ()
    outcome = (*_goal_notice(page.document), *_call_notice(page.document))
    found = ((words, first_text(page.document, predicate)) for predicate, words in _NOTICED)
    notices = tuple(Notice(f"{words}: {text}", NoticeLevel.WARNING) for words, text in found if text)
    warning = "" if page.site.stop_warning else first_text(page.document, ros.warning)  # every page shows these
    return (Notice(warning, NoticeLevel.ERROR), *outcome, *notices) if warning else (*outcome, *notices)


def _goal_notice(document: Document) -> tuple[Notice, ...]:
    """Return a notice about the state of a goal; empty for other documents."""
    word, about = first_text(document, ros.statusWord), first_text(document, ros.words)
    if not word or ros.Goal not in objects_of(document, rdf.type):
        return ()
    status = objects_of(document, ros.status)
    sentence = f"The goal {_GOAL_VERBS.get(word, 'is')} {word}{f': {about}' if about else ''}"
    is_failed = not _FAILED_GOALS.isdisjoint(status)
    level = NoticeLevel.ERROR if is_failed else NoticeLevel.GOOD if ros.Succeeded in status else NoticeLevel.INFO
    return (Notice(sentence, level),)


def _call_notice(document: Document) -> tuple[Notice, ...]:
    """Return a notice about the state of a call; empty for other documents."""
    if ros.Call not in objects_of(document, rdf.type):
        return ()
    about = first_text(document, ros.words)
    return tuple(
        Notice(f"{sentence}: {about}" if about else sentence, level)
        for state in objects_of(document, ros.state)
        if isinstance(state, NamedNode)
        for sentence, level in (_CALLS[state],)
    )


def _curl(url: str, accept: str) -> str:
    """Return a command line that fetches `url`, quoted safely for any name."""
    return f"curl -H 'Accept: {accept}' '{_shell(url)}'"


def _shell(url: str) -> str:
    return quote(url, safe=":/?#[]@!$&()*+,;=%-._~")


def render_entry(page: EntryPage) -> bytes:
    """Return the entry page: the robot, the number of its resources, and where to continue."""
    example = page.example or f"{page.site.base}topics/"
    tries = (
        ("The topics of the robot, as Turtle", _curl(f"{page.site.base}topics/", "text/turtle")),
        ("One topic, as plain JSON", _curl(example, "application/json")),
        (
            "A query over the whole robot",
            f"curl '{_shell(page.site.base)}sparql' -H 'Accept: text/csv' \\\n  --data-urlencode "
            f"'query=SELECT ?topic ?type WHERE {{ ?topic <{page.site.vocabulary}hasMessageType> ?type }}'",
        ),
    )
    return render_template(
        "entry.html",
        page_frame(page.site, page.site.name, page.site.base, page.notices, is_refreshed(page)),
        page=page,
        formats=page.alternates,
        data=structured_data_script(page.document),
        counts=[(count, page.site.href(count.url)) for count in page.counts],
        sections=describe(page.document, page.site, without=(ldp.contains,)),
        tries=tries if page.example else (tries[0], tries[2]),
    )


def render_sparql(page: SparqlPage) -> bytes:
    """Return the page of the SPARQL endpoint: an editor, results, and stored queries as examples."""
    query = page.query or _FIRST_QUERY.format(vocabulary=page.site.vocabulary)
    return render_template(
        "sparql.html",
        page_frame(page.site, "SPARQL", f"{page.site.base}sparql", page.notices),
        page=page,
        query=escape_controls(query),
        config=_editor_config(page),
        lines=max(8, min(24, query.count("\n") + 2)),
        action=f"{page.site.root}sparql",
        choices=_FORMATS,
        results=results_table(page.results, page.site) if page.results else None,
        examples=[(each, page.site.href(each.url)) for each in page.examples],
        endpoint=f"{page.site.base}sparql",
    )


def _editor_config(page: SparqlPage) -> str:
    """Return the configuration of the editor as JSON.

    `isAsked`: whether the query is that of the page's URL. `terms`: the prefixed names that each module of the
    vocabulary describes, by its path below the root.
    """
    site = page.site
    terms: dict[str, list[str]] = {}
    for iri, module in home_of_terms().items():
        terms.setdefault(module_url(module, ""), []).append(site.prefixed_name(iri))
    return json.dumps(
        {
            "endpoint": f"{site.root}sparql",
            "base": site.base,
            "root": site.root,
            "types": site.types,
            "prefixes": PREFIXES,
            "terms": terms,
            "isAsked": bool(page.query),
        }
    )


def render_query(page: QueryPage) -> bytes:
    """Return the page of a stored query with its purpose, parameters, results and text."""
    return render_template(
        "query.html",
        page_frame(page.site, page.query.name, page.query.url, page.notices),
        page=page,
        action=page.site.href(page.query.url),
        edit=f"{page.site.root}sparql?query={quote(page.query.text.encode('utf-8', 'replace'), safe='')}",
        choices=_FORMATS,
        results=results_table(page.results, page.site) if page.results else None,
    )


def render_search(page: SearchPage) -> bytes:
    """Return the page of the search: the box and a table of results."""
    pictures = page.pictures
    found = (
        (result, page.site.anchor(result.member.url), [page.site.anchor(type) for type in _types(result, page.site)])
        for result in page.results
    )
    return render_template(
        "find.html",
        page_frame(page.site, page.query or "Search", page.url, page.notices, query=page.query),
        page=page,
        formats=_alternates(page.url),
        rows=[
            (
                *(anchor, result.kind, types, _found_by(result), brief_text(result.member.value or "null")),
                thumbnail_view(pictures[anchor.url], page.site) if anchor.url in pictures else None,
            )
            for result, anchor, types in found
            if anchor is not None
        ],
        about=[(concept, anchor) for concept, url in page.about.items() if (anchor := page.site.anchor(url))],
    )


_GRAPH_FORMATS = (Alternate("SVG", "image/svg+xml", "svg"), Alternate("DOT", "text/vnd.graphviz", "dot"))


def render_graph(page: GraphPage) -> bytes:
    """Return the page of the computation graph: its drawing, its problems in words, and a choice of namespaces."""
    return render_template(
        "graph.html",
        page_frame(page.site, "Graph", page.url, page.notices, live=True),
        page=page,
        svg=Markup(page.svg),
        formats=_alternates(page.url, *_GRAPH_FORMATS),
        problems=[
            (anchor, escape_controls(words))
            for url, words in page.problems
            if (anchor := page.site.anchor(url)) is not None
        ],
    )


def _types(result: SearchResult, site: Site) -> Iterator[str]:
    return (f"{site.types}{name}" for name in result.member.types)


def _found_by(result: SearchResult) -> str:
    """Return the matching part of a result if its name does not show it."""
    if result.field is not None:
        return f"{result.match} {result.field}"
    return result.match if result.match in ("text", "type", "meaning") else ""


def render_plot(page: PlotPage) -> bytes:
    """Return the page of a plot: the configuration of its script, and the numbers in a table."""
    site = page.site
    rows = [
        {
            "topic": site.anchor(number.topic),
            "field": escape_controls(number.field),
            "type": number.type,
            "series": None if number.series is None else site.href(number.series),
            "without": f"{site.root}plot{plot_query([each for each in page.references if each != reference])}",
        }
        for number, reference in zip(page.numbers, page.references, strict=True)
    ]
    return render_template(
        "plot.html",
        page_frame(
            site, ", ".join(escape_controls(each.field) for each in page.numbers) or "Plot", page.url, page.notices
        ),
        page=page,
        rows=rows,
        references=page.references,
        config=json.dumps(
            {"stream": f"{site.root}plot{plot_query(page.references)}", "y": plot_lines(page.numbers, site)}
        ),
        formats=_alternates(page.url),
    )


_MAX_FRAMES = 1000


def render_frames(page: FramesPage) -> bytes:
    """Return the page of the frames: a table, indented by depth."""
    return render_template(
        "frames.html",
        page_frame(page.site, "Frames", page.url, page.notices, live=True),
        page=page,
        rows=[frame_row(each, page.site, page.node_url) for each in page.nodes[:_MAX_FRAMES]],
        omitted=max(len(page.nodes) - _MAX_FRAMES, 0),
        trees=sum(each.depth == 0 and (each.newest is not None or not each.problem) for each in page.nodes),
        formats=ALTERNATES,
    )


def render_space(page: SpacePage) -> bytes:
    """Return the page of a view of space: the configuration of its script, and the same as text."""
    site = page.site
    rows = [
        {
            "topic": site.anchor(each.url),
            "kind": each.kind,
            "frame": escape_controls(each.frame),
            "where": "" if each.pose is None else pose_words(each.pose),
            "problem": escape_controls(each.problem),
        }
        for each in page.topics
    ]
    return render_template(
        "space.html",
        page_frame(site, "In three dimensions" if page.is_3d else "Seen from above", page.url, page.notices),
        page=page,
        rows=rows,
        above=f"{site.root}space{space_query(page.wanted, page.references)}",
        solid=f"{site.root}space{space_query(page.wanted, page.references, is_3d=True)}",
        model=f"{site.root}{page.model.removeprefix(site.base)}" if page.model else "",
        types=PLACED_TYPES,
        formats=_alternates(page.url),
    )


def render_diagnostics(page: DiagnosticsPage) -> bytes:
    """Return the page of diagnostics: sections by level, the worst first, and the history of one component."""
    site, base = page.site, page.url.partition("?")[0]
    groups = [
        (words, [each for each in page.states if each.level is level])
        for level, words in LEVELS.items()
        if any(each.level is level for each in page.states)
    ]
    return render_template(
        "diagnostics.html",
        page_frame(site, page.name or "Diagnostics", page.url, page.notices, live=True),
        page=page,
        groups=groups,
        words=LEVELS,
        href=lambda name: f"{site.href(base)}?name={quote(name.encode('utf-8', 'replace'), safe='')}",
        when=time_view,
        topics=[anchor for url in page.topics if (anchor := site.anchor(url)) is not None],
        formats=_alternates(page.url),
    )


def render_cockpit(page: CockpitPage) -> bytes:
    """Return the page of a cockpit: its panels in a grid, and the forms that change and copy it."""
    site = page.site
    panels = panel_views(page.panels, site, page.csrf)
    parts = {each.part for each in panels}
    others = [(site.href(url), escape_controls(name), url == page.url) for url, name in page.others]
    is_live = page.edit is None or page.edit.submitted is None
    name = readable_path(page.url.rpartition("/")[2])
    return render_template(
        "cockpit.html",
        page_frame(site, page.cockpit.title or name, page.url, page.notices, live=is_live),
        page=page,
        panels=panels,
        parts=parts,
        others=[each for each in others if each[0] is not None],
        levels=LEVELS,
        kinds=KINDS,
        container=f"{site.root}cockpit/",
        copy_token=page.csrf(f"{site.base}cockpit/"),
        token=page.csrf(""),
        formats=ALTERNATES,
    )


def render_problem(page: ProblemPage) -> bytes:
    """Return the page of an error (RFC 9457): the cause, the invalid field, and where to continue."""
    return render_template(
        "problem.html",
        page_frame(page.site, f"{page.status} {page.title}", page.url, ()),
        page=page,
        near=[anchor for url in page.near if (anchor := page.site.anchor(url)) is not None],
    )
