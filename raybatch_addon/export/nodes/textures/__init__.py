"""Handlers of Blender's texture nodes."""
