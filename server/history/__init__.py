"""Recordings being made and read: MCAP segments with an index, and what feeds them from live topics."""
