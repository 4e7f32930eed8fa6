"""Tests of raybatch_addon/core/device."""
