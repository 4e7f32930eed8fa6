"""The tree over emitters: which two nodes each of its nodes joins, and how it is filled."""
