"""Files that each version saved, with every setting unlike its default, and a test that opens them."""
