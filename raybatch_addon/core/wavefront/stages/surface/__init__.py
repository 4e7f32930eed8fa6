"""The stages at a surface: its vertex, the light that is aimed at, and what its material does."""
