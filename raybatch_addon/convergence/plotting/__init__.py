"""Plots without Blender: letters, lines and logarithmic axes, drawn into arrays."""
