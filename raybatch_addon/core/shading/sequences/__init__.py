"""Random numbers of paths, keyed by their purpose: the sequences that a pixel's samples can follow."""
