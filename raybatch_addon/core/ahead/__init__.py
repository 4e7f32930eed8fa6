"""Kernels ahead of need: what a render needs, processes that compile it, and the change to it in mid-render."""
