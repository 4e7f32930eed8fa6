"""The path tracer, which knows nothing of Blender: `session.py` is its only door."""
