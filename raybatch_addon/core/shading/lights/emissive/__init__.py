"""Emissive triangles on the device, as the table of lights has them."""
