"""The paper's aircraft, embedded: `rosld serve aircraft`."""

from rosld.adapters.aircraft.adapter import Aircraft
from rosld.adapters.base import Adapter, AdapterOptions

SCHEME = "aircraft"


def adapter(source: str, options: AdapterOptions) -> Adapter:
    """Return the adapter of the source `aircraft`. Raises ValueError for anything after it."""
    if source.rstrip(":/") != SCHEME:
        raise ValueError(f"there is only one aircraft: use {SCHEME!r}, not {source!r}")
    return Aircraft(options)


__all__ = ["Aircraft", "adapter"]
