"""Features of portals: surfaces that send rays on elsewhere, and portals of the world."""
