"""A render around the loop: rounds of samples, workers, and how a stopped render is resumed."""
