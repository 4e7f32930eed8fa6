"""Programs of shader graphs: how they are built, stored, and run in kernels."""
