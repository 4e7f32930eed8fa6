"""The parts of stability.py."""
