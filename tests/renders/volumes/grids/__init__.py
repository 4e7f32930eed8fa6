"""Tests of grids that volumes read: how they move, and between their voxels."""
