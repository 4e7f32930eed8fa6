"""Shadow catchers: paths that meet one first go on twice, with all that is there and with catchers alone."""
