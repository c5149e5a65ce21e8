"""Search: ranked full-text search of a robot's resources, and names similar to a missing one."""
