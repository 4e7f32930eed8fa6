"""Features of shadow catchers."""
