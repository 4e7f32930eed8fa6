"""Stability cases of materials."""
