"""Tests of what others get: the manual, the site of the documents, and the repository of extensions."""
