"""Handlers of Blender's nodes on numbers, vectors and colors."""
