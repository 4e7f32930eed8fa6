"""Scripts that make large scenes, and measure them on several devices."""
