"""The files that pages are drawn with: stylesheets, scripts, the icon; each is read once."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.resources import files

from rosld.server.html.cockpit import cockpit_style

_OWN = (
    "style.css",
    "query_editor.css",
    "icon.svg",
    "live.js",
    "ages.js",
    "filter.js",
    "find.js",
    "drive.js",
    "picture.js",
    "chart.js",
    "plot.js",
    "spark.js",
    "space_view.js",
    "space.js",
    "space3d.js",
    "query_terms.js",
    "query_parameters.js",
    "query_views.js",
    "query_editor.js",
)
_VENDORED = ("three.js", "uplot.js", "uplot.css", "yasgui.js", "yasgui.css")
"""What others wrote; the licence of each lies beside it in `vendor/`."""


def _read_assets() -> dict[str, bytes]:
    here = files("rosld.server.html")
    own = {name: (here / name).read_bytes() for name in _OWN}
    vendored = {name: (here / "vendor" / name).read_bytes() for name in _VENDORED}
    return {**own, **vendored, "cockpit.css": cockpit_style()}


ASSETS: Mapping[str, bytes] = _read_assets()
"""The bytes of each file, by its name below the base, where it is served."""
ASSETS_VERSION = hashlib.blake2b(b"".join(ASSETS.values()), digest_size=4).hexdigest()
"""Another one whenever a file changes: pages name it in the URLs of files, so that no browser keeps an old one."""
