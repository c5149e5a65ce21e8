"""The documentation at `/docs/`: pages (HTML, Markdown), the search in them (`?q=`), and their files."""

from __future__ import annotations

import asyncio
import mimetypes
from collections.abc import Mapping

from starlette.responses import Response

from rosld.ontology.urls import Location, Space
from rosld.server.html.documentation import (
    FOLDERS,
    ROUTE,
    documents,
    is_page,
    page_body,
    search,
    sections,
    title_of,
)
from rosld.server.html.frame import page_frame, render_template
from rosld.server.html.site import Site
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import OBJECT
from rosld.server.resources.entry_point import FileResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import HTML
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.path_item import PathItem, QueryParameter
from rosld.server.rest.resource import LDP, RESOURCE, Resource, permanent_redirect
from rosld.server.rest.responses import bytes_response, resource_headers

MARKDOWN = "text/markdown"
_FORMATS: Mapping[str, str] = {"md": MARKDOWN, "html": HTML}
_QUERY = (
    QueryParameter("q", "Words to search for in the documentation."),
    QueryParameter(
        "format", "The requested representation; overrides Accept.", {"type": "string", "enum": [*_FORMATS]}
    ),
)
_MAX_QUERY = 200
_PLAIN = "text/plain"


class DocumentationResource(Resource):
    """A page of the documentation, or a folder of pages."""

    kind = "Documentation"
    item = PathItem("The documentation", tuple(_FORMATS.values()), OBJECT, _QUERY, streams=False)
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, space: Space, pages: PageRenderer, name: str) -> None:
        super().__init__(space, f"{space.container(ROUTE)}{name}")
        self._pages = pages
        self._name = name

    async def custom_get(self, exchange: Exchange) -> Response | None:
        offered = tuple(_FORMATS.values())
        media_type = exchange.preferred(_FORMATS, offered)
        if media_type is None:
            raise Problem(406, f"The documentation is available as {' and '.join(offered)}.")
        headers = resource_headers(self)
        if media_type == HTML:
            headers |= self._pages.headers
            site = self._pages.site_for(exchange.permissions)
            data = await asyncio.to_thread(self._page, site, exchange.query.get("q", "")[:_MAX_QUERY])
        else:
            data = self._markdown().encode()
        etag = ETag(digest(data), "html" if media_type == HTML else "md")
        return bytes_response(exchange, data, f"{media_type}; charset=utf-8", etag, headers.items())

    def _page(self, site: Site, query: str) -> bytes:
        """Return the page, or what a search finds in all pages."""
        folder = "" if query or is_page(self._name) else self._name
        title = f"Search: {query}" if query else FOLDERS[folder.rstrip("/")] if folder else title_of(self._name)
        return render_template(
            "documentation.html",
            page_frame(site, title, self.url, ()),
            query=query,
            found=search(query) if query else (),
            pages=_pages_of(folder) if folder else {},
            headings=() if query or folder else [each for each in sections(self._name)[1:] if each.level == 2],
            body="" if query or folder else page_body(self._name, site.root),
        )

    def _markdown(self) -> str:
        if is_page(self._name):
            return documents()[self._name].read_text("utf-8")
        lines = (f"- [{title}]({name.rpartition('/')[2]})" for name, title in _pages_of(self._name).items())
        return "\n".join((f"# {FOLDERS[self._name.rstrip('/')]}", "", *lines, ""))


def _pages_of(folder: str) -> Mapping[str, str]:
    """Return the titles of the pages of a folder, by name."""
    return {name: title_of(name) for name in documents() if name.startswith(folder) and is_page(name)}


def documentation_route(space: Space, pages: PageRenderer, location: Location) -> Resource:
    """Return the page, folder or file at `/docs/` or below. Raises a 404 Problem if there is none."""
    name = "/".join(location.segments)
    if not location.is_container and (not name or name in FOLDERS):
        raise permanent_redirect(space.container(ROUTE, location.segments))
    if location.is_container and (not name or name in FOLDERS) and is_page(""):
        return DocumentationResource(space, pages, f"{name}/" if name else "")
    page = name.removesuffix(".md").removesuffix("README")
    if name.endswith(".md") and is_page(page):
        raise permanent_redirect(f"{space.container(ROUTE)}{page}")
    if location.is_container or name not in documents():
        raise Problem(404, f"The documentation has no {name}: search it at {space.container(ROUTE)}?q=WORDS")
    if is_page(name):
        return DocumentationResource(space, pages, name)
    guessed = mimetypes.guess_type(name)[0] or ""
    media_type = guessed if guessed.startswith("image/") else f"{_PLAIN}; charset=utf-8"
    return FileResource(
        space, f"{ROUTE}/{name}", documents()[name].read_bytes(), media_type, "A file of the documentation"
    )
