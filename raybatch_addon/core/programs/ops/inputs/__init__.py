"""Ops that read the shaded point, its object, the ray and the camera."""
