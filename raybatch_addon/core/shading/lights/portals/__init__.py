"""Portals: openings through which a world is sampled."""
