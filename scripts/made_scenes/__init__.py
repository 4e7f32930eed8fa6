"""Large scenes that are made by rule, from a seed: grids, forests, and an island of millions of instances."""
