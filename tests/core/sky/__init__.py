"""Tests of raybatch_addon/core/sky."""
