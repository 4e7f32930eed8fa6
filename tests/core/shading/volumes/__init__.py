"""Tests of volumes apart from kernels."""
