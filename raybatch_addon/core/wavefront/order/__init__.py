"""The order of rays and hits: whether and how they are sorted."""
