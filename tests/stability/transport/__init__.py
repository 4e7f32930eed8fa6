"""Stability cases of light transport, textures, numbers and scheduling."""
