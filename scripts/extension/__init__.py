"""The repository that users install RayBatch from, beside the zips of `package.py`."""
