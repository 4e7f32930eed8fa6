"""Previews in Blender."""
