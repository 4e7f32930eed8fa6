"""Rivals of batching: other ways, from the literature, to trace many rays together, for benchmark.py traversal alone."""
