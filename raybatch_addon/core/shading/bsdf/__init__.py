"""Closures: how surfaces scatter light, a file for each model."""
