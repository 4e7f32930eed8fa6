"""Images beyond memory in the loop: paths whose surfaces ask for tiles that are not on the device wait for them."""
