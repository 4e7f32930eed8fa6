"""Volumes: the phase functions by which they scatter, and what several of them are together at a point."""
