"""Rays that wait at several treelets at a time."""
