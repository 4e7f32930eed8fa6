"""The parts of check_tracing.py and check_schedules.py."""
