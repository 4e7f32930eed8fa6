"""Tests of raybatch_addon/core/settings."""
