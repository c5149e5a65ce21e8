"""Robots behind a Foxglove server, such as foxglove_bridge or a program that uses the Foxglove SDK."""

from rosld.adapters.foxglove.adapter import FoxgloveAdapter, adapter

__all__ = ["FoxgloveAdapter", "adapter"]
