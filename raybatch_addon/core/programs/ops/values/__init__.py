"""Ops on numbers, vectors and colors."""
