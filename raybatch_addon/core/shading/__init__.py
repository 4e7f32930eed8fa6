"""Shading: what a surface, a light or a camera does to a ray."""
