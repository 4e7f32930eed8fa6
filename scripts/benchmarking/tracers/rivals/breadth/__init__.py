"""Rays that are sorted to packets, whose frusta go through the tree level by level."""
