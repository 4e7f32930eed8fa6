"""Tracers: how the rays of the loop are traced, at once or in batches."""
