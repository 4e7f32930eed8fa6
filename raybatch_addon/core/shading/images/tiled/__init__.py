"""Pictures in tiles, of which the device holds those that paths ask for."""
