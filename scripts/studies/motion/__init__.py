"""Trees over time: what things that move cost the rays of a tree, and ways to pay less."""
