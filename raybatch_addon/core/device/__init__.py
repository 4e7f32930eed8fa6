"""Devices, and how kernels are declared and launched on them."""
