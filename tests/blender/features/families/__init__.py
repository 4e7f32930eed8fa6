"""Features of Blender that are compared with Cycles, a file a family."""
