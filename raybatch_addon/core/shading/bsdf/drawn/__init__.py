"""Reflections as they are drawn: light and shade with an edge between them."""
