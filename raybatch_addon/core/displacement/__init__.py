"""Displacement: vertices that their materials move before trees are built."""
