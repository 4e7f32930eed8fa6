"""Handlers of Blender's shader nodes."""
