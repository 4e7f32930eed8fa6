"""Lights: their shapes, their brightness, the choice among them, and rays that meet them."""
