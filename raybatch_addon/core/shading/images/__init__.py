"""Images: their upload to the device, and their look-up."""
