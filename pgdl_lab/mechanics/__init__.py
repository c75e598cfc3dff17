"""What finite-element models share: bodies, materials, elements, solvers and the load path. Units: mm, N, MPa, s, tonne."""
