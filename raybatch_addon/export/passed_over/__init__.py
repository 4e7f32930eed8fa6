"""What is set in a scene and not heard: found by a look at properties, a row for each."""
