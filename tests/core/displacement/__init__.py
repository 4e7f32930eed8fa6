"""Tests of raybatch_addon/core/displacement."""
