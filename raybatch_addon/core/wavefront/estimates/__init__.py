"""Estimates before a render: how bright triangles, worlds and lamps are whose light programs compute."""
