"""Programs of shader graphs: their ops, a file a family, and the interpreter that runs them."""

from . import closure_ops, convert, coordinates  # noqa: F401  (files of ops register what they hold)
