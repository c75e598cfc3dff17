"""What a trained surrogate needs to work on a robot or in a browser: NumPy alone, unless a module says otherwise."""
