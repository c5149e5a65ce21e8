"""Worker processes for what would keep the event loop from running: large documents parsed, patched and rendered."""

from rosld.server.runtime.offload.pool import Work, Workers

__all__ = ["Work", "Workers"]
