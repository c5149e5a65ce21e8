"""Search: what a robot has by words, ranked; and the names that are near one that is not there."""
