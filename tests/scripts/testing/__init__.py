"""Tests of the scripts that run tests, or try Blender's program."""
