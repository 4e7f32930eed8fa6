"""Whole renders: determinism, radiance, rounds, schedules."""
