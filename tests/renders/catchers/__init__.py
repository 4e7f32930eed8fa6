"""Surfaces that send rays on elsewhere, and portals through which the world is sampled, in whole renders."""
