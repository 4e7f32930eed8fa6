"""Passes of what paths meet and where their light comes from: what is kept of a path, and what writes it."""
