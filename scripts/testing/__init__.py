"""Whole checks: everything there is on the CPU, all that needs no Blender on a GPU, and reports of what was run."""
