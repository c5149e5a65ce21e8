"""Recordings: `rosld serve run.bag`, a ROS 2 folder, an `.mcap` a `.db3` file; a part: `run.bag?from=-60&rate=2`.

Several, a glob, and a folder that is no ROS 2 bag are a collection.
"""

from pathlib import Path

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.recording.adapter import RecordingAdapter
from rosld.adapters.recording.collection import CollectionAdapter, is_glob
from rosld.adapters.recording.part import WHOLE, parse_part
from rosld.adapters.recording.rosbag2 import is_one_recording

_SCHEME = "recording:"


def adapter(source: str, options: AdapterOptions) -> Adapter:
    """Return the adapter of a recording: a path, with an optional `recording:` prefix and an optional part as a query.

    Several paths, one a line, are a collection. Raises ValueError for options out of range.
    """
    if source.startswith(_SCHEME) and not Path(source).exists():
        source = source.removeprefix(_SCHEME)
    sources, path, part = source.splitlines(), Path(source), WHOLE
    is_folder = path.expanduser().is_dir() and not is_one_recording(path.expanduser())
    if len(sources) > 1 or is_folder or is_glob(source):
        return CollectionAdapter(sources, options)
    if "?" in path.name and not path.expanduser().exists():
        name, _, query = str(path).partition("?")
        path, part = Path(name), parse_part(query)
        if path.expanduser().is_dir() and not is_one_recording(path.expanduser()):
            raise ValueError(f"{name} is a folder of recordings: a part can only be of one of them")
    return RecordingAdapter(path.expanduser(), options, part=part)


__all__ = ["CollectionAdapter", "RecordingAdapter", "adapter"]
