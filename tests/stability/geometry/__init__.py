"""Stability cases of geometry, scale and position."""
