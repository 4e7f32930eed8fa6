"""Studies of docs/studies: what they measure."""
