"""What a kernel does for one entry of its list, as a function of other kernels.

A kernel over a list begins with `i = wp.tid()`, ends where that is not below the list's length, and does its work for
entry i. Called as a function for a list of one entry, it is to do so for i = 0.
"""

from __future__ import annotations

import ast
import functools

import warp as wp


class _FirstThread(ast.NodeTransformer):
    """Puts 0 in place of `wp.tid()`."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        called = node.func
        if isinstance(called, ast.Attribute) and called.attr == "tid" and not node.args:
            return ast.copy_location(ast.Constant(0), node)
        return self.generic_visit(node)


@functools.cache
def function_of(kernel: wp.Kernel) -> wp.Function:
    """The function that does what the first thread of `kernel` does, with its arguments. The kernel stays as it is."""
    return wp._src.context.Function(
        kernel.func, f"{kernel.key}_of_one", "", module=None, code_transformers=[_FirstThread()]
    )
