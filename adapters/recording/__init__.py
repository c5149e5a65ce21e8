"""Recordings: `rosld serve run.bag`, a ROS 2 folder, an `.mcap` a `.db3` file; a part: `run.bag?from=-60&rate=2`."""

from pathlib import Path

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.recording.adapter import RecordingAdapter
from rosld.adapters.recording.part import WHOLE, parse_part

_SCHEME = "recording:"


def adapter(source: str, options: AdapterOptions) -> Adapter:
    """Return the adapter of a recording: a path, with an optional `recording:` prefix and an optional part as a query.

    Raises ValueError for options out of range.
    """
    path, part = Path(source), WHOLE
    if source.startswith(_SCHEME) and not path.exists():
        path = Path(source.removeprefix(_SCHEME))
    if "?" in path.name and not path.expanduser().exists():
        name, _, query = str(path).partition("?")
        path, part = Path(name), parse_part(query)
    return RecordingAdapter(path.expanduser(), options, part=part)


__all__ = ["RecordingAdapter", "adapter"]
