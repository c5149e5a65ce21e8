"""The files that pages are drawn with: their style, their icon, and their scripts."""

from __future__ import annotations

from collections.abc import Callable

from starlette.responses import Response

from rosld.server import html
from rosld.server.http.conditional import ETag, check_preconditions, digest
from rosld.server.http.link import Link
from rosld.server.hypermedia.json_schema import OBJECT
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.context import Robot
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import LDP, RESOURCE, Resource
from rosld.server.rest.resource_headers import resource_headers

_DAY = 86400


class FileResource(Resource):
    """A file that never changes in one version of rosld."""

    kind = "File"
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, robot: Robot, name: str, data: bytes, media_type: str, summary: str) -> None:
        super().__init__(robot.space.base + name)
        self._data = data
        self._media_type = media_type
        self._summary = summary

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(self._summary, (self._media_type.partition(";")[0],), OBJECT, (), streams=False)

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


def stylesheet(robot: Robot) -> FileResource:
    """`/style.css`."""
    return FileResource(robot, "style.css", html.STYLESHEET, "text/css; charset=utf-8", "The style of pages")


def script(robot: Robot) -> FileResource:
    """`/live.js`."""
    return FileResource(
        robot, "live.js", html.SCRIPT, "text/javascript; charset=utf-8", "The script that keeps pages up to date"
    )


def ages_script(robot: Robot) -> FileResource:
    """`/ages.js`."""
    summary = "The script that says how long ago times were"
    return FileResource(robot, "ages.js", html.AGES_SCRIPT, "text/javascript; charset=utf-8", summary)


def filter_script(robot: Robot) -> FileResource:
    """`/filter.js`."""
    return FileResource(
        robot,
        "filter.js",
        html.FILTER_SCRIPT,
        "text/javascript; charset=utf-8",
        "The script that finds things on long pages",
    )


def find_script(robot: Robot) -> FileResource:
    """`/find.js`."""
    return FileResource(
        robot,
        "find.js",
        html.FIND_SCRIPT,
        "text/javascript; charset=utf-8",
        "The script that shows what is found while words are typed",
    )


def drive_script(robot: Robot) -> FileResource:
    """`/drive.js`."""
    return FileResource(
        robot, "drive.js", html.DRIVE_SCRIPT, "text/javascript; charset=utf-8", "The script of the pad that drives"
    )


def picture_script(robot: Robot) -> FileResource:
    """`/picture.js`."""
    return FileResource(
        robot,
        "picture.js",
        html.PICTURE_SCRIPT,
        "text/javascript; charset=utf-8",
        "The script of pictures that move while they are looked at",
    )


def plot_script(robot: Robot) -> FileResource:
    """`/plot.js`."""
    return FileResource(
        robot, "plot.js", html.PLOT_SCRIPT, "text/javascript; charset=utf-8", "The script that draws plots"
    )


def spark_script(robot: Robot) -> FileResource:
    """`/spark.js`."""
    summary = "The script that draws beside numbers how they were lately"
    return FileResource(robot, "spark.js", html.SPARK_SCRIPT, "text/javascript; charset=utf-8", summary)


def plot_library(robot: Robot) -> FileResource:
    """`/uplot.js`."""
    return FileResource(robot, "uplot.js", html.PLOT_LIBRARY, "text/javascript; charset=utf-8", "uPlot, which draws")


def plot_stylesheet(robot: Robot) -> FileResource:
    """`/uplot.css`."""
    return FileResource(robot, "uplot.css", html.PLOT_STYLESHEET, "text/css; charset=utf-8", "The style of uPlot")


def icon(robot: Robot) -> FileResource:
    """`/icon.svg`."""
    return FileResource(robot, "icon.svg", html.ICON, "image/svg+xml", "The icon of pages")


def favicon(robot: Robot) -> FileResource:
    """`/favicon.ico`: the icon where browsers look for it."""
    summary = "The icon of pages, where browsers look for it"
    return FileResource(robot, "favicon.ico", html.ICON, "image/svg+xml", summary)


FILES: dict[str, Callable[[Robot], FileResource]] = {
    "style.css": stylesheet,
    "live.js": script,
    "ages.js": ages_script,
    "filter.js": filter_script,
    "find.js": find_script,
    "drive.js": drive_script,
    "picture.js": picture_script,
    "plot.js": plot_script,
    "spark.js": spark_script,
    "uplot.js": plot_library,
    "uplot.css": plot_stylesheet,
    "icon.svg": icon,
    "favicon.ico": favicon,
}
