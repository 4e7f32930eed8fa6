"""Pages that scripts make parts of."""
