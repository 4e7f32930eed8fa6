"""RayBatch's tests; the folders mirror those of the code."""
