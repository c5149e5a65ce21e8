"""The files that pages are drawn with: their style, their icon, and their scripts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from starlette.responses import Response

from rosld.ontology.urls import Space
from rosld.server.html.frame import ASSETS
from rosld.server.http.conditional import ETag, check_preconditions, digest
from rosld.server.http.fields import Link
from rosld.server.hypermedia.json_schema import OBJECT
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import LDP, RESOURCE, Resource
from rosld.server.rest.responses import resource_headers

_DAY = 86400
_SCRIPT, _STYLE, _ICON = "text/javascript; charset=utf-8", "text/css; charset=utf-8", "image/svg+xml"


class FileResource(Resource):
    """A file that never changes in one version of rosld."""

    kind = "File"
    passes_unknown_parameters = frozenset({"GET", "HEAD"})  # browsers add some to bypass caches
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, space: Space, name: str, data: bytes, media_type: str, summary: str) -> None:
        super().__init__(space, space.base + name)
        self._data = data
        self._media_type = media_type
        self.item = PathItem(summary, (media_type.partition(";")[0],), OBJECT, (), streams=False)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        etag = ETag(digest(self._data), "bin")
        headers = {
            **resource_headers(self),
            "etag": str(etag),
            "cache-control": f"max-age={_DAY}",
            "x-content-type-options": "nosniff",
        }
        if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
        if check_preconditions(exchange.method, etag, if_match=if_match, if_none_match=if_none_match):
            return Response(status_code=304, headers=headers)
        return Response(self._data, media_type=self._media_type, headers=headers)


_FILES: Mapping[str, tuple[str, str]] = {
    "style.css": (_STYLE, "The style of pages"),
    "live.js": (_SCRIPT, "The script that keeps pages up to date"),
    "ages.js": (_SCRIPT, "The script that says how long ago times were"),
    "filter.js": (_SCRIPT, "The script that finds things on long pages"),
    "find.js": (_SCRIPT, "The script that shows what is found while words are typed"),
    "drive.js": (_SCRIPT, "The script of the pad that drives"),
    "picture.js": (_SCRIPT, "The script of pictures that move while they are looked at"),
    "chart.js": (_SCRIPT, "The script that says what plots look like"),
    "plot.js": (_SCRIPT, "The script that draws plots"),
    "spark.js": (_SCRIPT, "The script that draws beside numbers how they were lately"),
    "space_view.js": (_SCRIPT, "The script of what views of space have alike"),
    "space.js": (_SCRIPT, "The script that draws views of space"),
    "space3d.js": (_SCRIPT, "The script that draws space in three dimensions"),
    "three.js": (_SCRIPT, "three.js, which draws three dimensions"),
    "uplot.js": (_SCRIPT, "uPlot, which draws"),
    "uplot.css": (_STYLE, "The style of uPlot"),
    "query_terms.js": (_SCRIPT, "The script that completes terms in queries"),
    "query_parameters.js": (_SCRIPT, "The script of the fields of a query's parameters"),
    "query_views.js": (_SCRIPT, "The script that draws results of queries"),
    "query_editor.js": (_SCRIPT, "The script of the editor of queries"),
    "query_editor.css": (_STYLE, "The style of the editor of queries"),
    "yasgui.js": (_SCRIPT, "YASGUI, in which queries are edited"),
    "yasgui.css": (_STYLE, "The style of YASGUI"),
    "cockpit.css": (_STYLE, "The style of cockpits"),
    "icon.svg": (_ICON, "The icon of pages"),
    "favicon.ico": (_ICON, "The icon of pages, where browsers look for it"),
}
"""Of each file, by its name below the base: its media type, and what it is."""


def _file_resource(name: str, space: Space) -> FileResource:
    """Return the file of a name in `FILES`."""
    return FileResource(space, name, ASSETS["icon.svg" if name == "favicon.ico" else name], *_FILES[name])


FILES: Mapping[str, Callable[[Space], FileResource]] = {name: partial(_file_resource, name) for name in _FILES}
"""What makes each, by its name."""
