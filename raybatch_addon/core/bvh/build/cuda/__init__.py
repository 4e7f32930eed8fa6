"""Binary trees by merging clusters along a Morton curve, improved by reinsertion, on the device."""
