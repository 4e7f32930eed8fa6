"""scripts/benchmark.py where it needs Blender."""
