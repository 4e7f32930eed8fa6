"""Tests of convergence in Blender: records of renders, and their panel."""
