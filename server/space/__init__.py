"""Frames of a robot, and drawings of messages in them. No I/O."""
