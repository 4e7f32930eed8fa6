"""Geometry beyond memory: pages of treelets in host memory or on disk, and which of them are on the device."""
