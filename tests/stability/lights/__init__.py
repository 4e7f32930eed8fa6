"""Stability cases of lights."""
