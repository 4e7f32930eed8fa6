"""Meshes and instances of the depsgraph as arrays."""
