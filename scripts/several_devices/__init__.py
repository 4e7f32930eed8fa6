"""Measures of devices that share a render."""
