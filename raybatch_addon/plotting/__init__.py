"""Plots drawn into arrays with NumPy alone: Blender has no plotting library."""
