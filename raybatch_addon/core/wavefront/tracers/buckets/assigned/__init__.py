"""Policies that serve several buckets in a step, chosen on the host from how many rays wait in each."""
