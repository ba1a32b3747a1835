"""The simulator: the world that estimates are judged against."""
