"""Worker processes for what would keep the event loop from running: large documents parsed, patched and rendered."""

from rosld.server.runtime.offload.pool import Work, WorkerPool

__all__ = ["Work", "WorkerPool"]
