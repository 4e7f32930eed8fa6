"""Tests of raybatch_addon/core/convergence."""
