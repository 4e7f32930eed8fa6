"""Records of renders: error and rays a second over time, and their plot."""
