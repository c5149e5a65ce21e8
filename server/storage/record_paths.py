"""The paths of records: which container one is in, and which may be paths at all."""

from __future__ import annotations

from rosld.server.storage.record import Model, Put, Write

_DIRECT = (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER)


def container_of(path: str) -> str:
    """The path of the container a record is in: `data/` of `data/a` and of `data/a/`; empty for a root."""
    return path[: path.rfind("/", 0, -1) + 1]


def check_write(write: Write) -> None:
    """Raises ValueError for a write that makes no sense whatever is there."""
    path = write.path
    if not path or path[0] == "/" or "//" in path:
        raise ValueError(f"{path!r} is no path of a record: it has an empty segment")
    if not isinstance(write, Put):
        return
    model = write.model
    if (path[-1] == "/") != model.is_container:
        raise ValueError(f"{path!r} cannot be a {model.value}: containers, and only they, end in a slash")
    if (write.blob is not None) != (model is Model.NON_RDF_SOURCE):
        raise ValueError(f"{path!r}: non-RDF sources, and only they, have a blob")
    if (write.membership is not None) != (model in _DIRECT):
        raise ValueError(f"{path!r}: Direct and Indirect containers, and only they, have a membership")
