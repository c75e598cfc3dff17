"""What finite-element models share: materials, elements, solvers, the load path. Units: mm, N, MPa, s, tonne."""
