"""The parts of check_tracing.py."""
