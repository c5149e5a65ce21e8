"""Worker processes for work that would block the event loop, or must be ended when it takes too long."""

from rosld.server.runtime.offload.pool import Work, WorkerPool

__all__ = ["Work", "WorkerPool"]
