"""What films are like where things are transparent."""
