"""Rays that programs of materials ask for, traced in turns of their own before the surface is shaded."""
