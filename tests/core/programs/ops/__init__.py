"""Tests of raybatch_addon/core/programs/ops."""
