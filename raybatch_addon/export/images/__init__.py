"""Blender's images and their color spaces as arrays."""
