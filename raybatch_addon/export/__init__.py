"""Blender's evaluated scene as the core's `Scene`; the only room that reads Blender's data."""
