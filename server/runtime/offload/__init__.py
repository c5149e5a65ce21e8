"""Worker processes for what would keep the event loop from running, or has to be ended when it takes too long."""

from rosld.server.runtime.offload.pool import Work, WorkerPool

__all__ = ["Work", "WorkerPool"]
