"""Tests of render.py without Blender."""
