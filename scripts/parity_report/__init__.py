"""The parts of parity.py."""
