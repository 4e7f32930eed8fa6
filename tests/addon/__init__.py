"""Tests of the add-on that need no Blender."""
