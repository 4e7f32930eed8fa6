"""The parts of convergence.py."""
