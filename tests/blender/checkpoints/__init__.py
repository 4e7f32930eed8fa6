"""Checkpoints of final renders in Blender."""
