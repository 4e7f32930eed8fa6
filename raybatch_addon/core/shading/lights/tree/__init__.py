"""The binary tree over emitters: which two nodes each of its nodes joins."""
