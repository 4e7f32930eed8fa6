"""References in Python and float64 that tests compare with."""
