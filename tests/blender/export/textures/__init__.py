"""Tests of textures of Blender's graphs."""
