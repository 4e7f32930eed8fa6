"""Handlers of Blender's input nodes."""
