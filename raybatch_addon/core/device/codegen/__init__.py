"""How Warp writes the C++ of kernels of the core: what it passes, and what it sets to zero."""

# Whoever changes that raises `CODE_VERSION` in `device/kernel.py`
