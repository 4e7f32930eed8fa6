"""Skies of a clear day, computed once on the host for the ops that look up directions."""
