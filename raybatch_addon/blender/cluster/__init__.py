"""Renders on a cluster, as Blender meets them: frames of an animation ahead, and command lines begun by a button."""
