"""Tests of passes in Blender: names, files, and beside those of Cycles."""
