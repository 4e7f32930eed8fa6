"""Rivals of batching: other ways, from the literature, to trace many rays together (benchmark.py traversal)."""
