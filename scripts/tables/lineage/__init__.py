"""The table of docs/studies/lineage.md: systems from the literature, where they are here, and what they are worth."""
