"""The robot's state at run time: the session, live topics, publishing, calls, goals, holds, the stop."""
