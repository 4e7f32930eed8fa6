"""Tests of what panels show, and of what their buttons do."""
