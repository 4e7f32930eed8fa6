"""Tests of raybatch_addon/core/native."""
