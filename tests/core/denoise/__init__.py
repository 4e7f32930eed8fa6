"""Tests of raybatch_addon/core/denoise."""
