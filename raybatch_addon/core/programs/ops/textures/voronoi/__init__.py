"""Voronoi textures: cells with random points, what a point of space has to do with them, and their ops."""
