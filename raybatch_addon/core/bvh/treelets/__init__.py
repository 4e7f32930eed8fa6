"""Treelets: subtrees that rays visit as a unit, and how a tree is cut into them."""
