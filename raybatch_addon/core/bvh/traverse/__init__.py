"""Traversal: rays through whole trees and through treelets, on CPUs and on CUDA."""
