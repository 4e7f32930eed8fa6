"""Tests of bad input, devices and faults through the whole engine."""
