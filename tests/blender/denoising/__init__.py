"""Denoising in Blender."""
