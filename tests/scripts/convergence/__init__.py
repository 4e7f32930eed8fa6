"""scripts/convergence.py."""
