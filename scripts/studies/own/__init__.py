"""Studies of one's own: what is measured stands in a file, which docs/studies/own.md describes."""
