"""The C++ of native functions: headers, and what puts them together."""
