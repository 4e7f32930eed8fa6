"""The site of the documents: laid out for Sphinx, built without the network, and checked."""
