"""Recordings: MCAP segments with an index, and the recording of live topics."""
