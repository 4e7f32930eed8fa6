"""Settings of a scene that are not heard: found by a look at properties, a row for each."""
