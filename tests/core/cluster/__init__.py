"""Renders shared by many processes and machines."""
