"""What the process has beside the robot and the web: memory, worker processes, clocks, signals, identifiers."""
