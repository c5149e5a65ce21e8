"""The files that pages are drawn with: their style, their icon, and their scripts."""

from __future__ import annotations

from collections.abc import Callable

from starlette.responses import Response

from rosld.server import html
from rosld.server.http.conditional import ETag, check_preconditions, digest
from rosld.server.http.link import Link
from rosld.server.resources.context import Robot
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import LDP, RESOURCE, Resource
from rosld.server.rest.resource_headers import standing_headers

_DAY = 86400


class FileResource(Resource):
    """A file that never changes in one version of rosld."""

    kind = "File"
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, robot: Robot, name: str, data: bytes, media_type: str) -> None:
        super().__init__(robot.space.base + name)
        self._data = data
        self._media_type = media_type

    async def special(self, exchange: Exchange) -> Response | None:
        etag = ETag(digest(self._data), "bin")
        headers = {
            **standing_headers(self),
            "etag": str(etag),
            "cache-control": f"max-age={_DAY}",
            "x-content-type-options": "nosniff",
        }
        if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
        if check_preconditions(exchange.method, etag, if_match=if_match, if_none_match=if_none_match):
            return Response(status_code=304, headers=headers)
        return Response(self._data, media_type=self._media_type, headers=headers)


def style(robot: Robot) -> FileResource:
    """`/style.css`."""
    return FileResource(robot, "style.css", html.STYLESHEET, "text/css; charset=utf-8")


def script(robot: Robot) -> FileResource:
    """`/live.js`."""
    return FileResource(robot, "live.js", html.SCRIPT, "text/javascript; charset=utf-8")


def filter_script(robot: Robot) -> FileResource:
    """`/filter.js`."""
    return FileResource(robot, "filter.js", html.FILTER_SCRIPT, "text/javascript; charset=utf-8")


def icon(robot: Robot, name: str = "icon.svg") -> FileResource:
    """`/icon.svg`."""
    return FileResource(robot, name, html.ICON, "image/svg+xml")


def favicon(robot: Robot) -> FileResource:
    """`/favicon.ico`: the icon where browsers look for it."""
    return icon(robot, "favicon.ico")


FILES: dict[str, Callable[[Robot], FileResource]] = {
    "style.css": style,
    "live.js": script,
    "filter.js": filter_script,
    "icon.svg": icon,
    "favicon.ico": favicon,
}
