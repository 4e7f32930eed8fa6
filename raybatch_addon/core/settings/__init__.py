"""Settings of a render: declared once for panel, command line and manual, checked, and in presets."""
