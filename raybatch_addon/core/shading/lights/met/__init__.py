"""Which lights without mesh a ray meets."""
