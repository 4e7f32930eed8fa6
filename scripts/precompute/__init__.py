"""The tables that the core ships (.npz), computed by quadrature."""
