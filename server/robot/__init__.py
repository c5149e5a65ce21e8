"""Run-time state of the robot: the session, live topics, publishing, calls, goals, holds and the stop."""
