"""Tests of renders without a window: options, frames, lines of progress and exit codes."""
