"""Tables and plots of the documentation, made from the code and from data."""
