"""Tests of raybatch_addon/core/measure."""
