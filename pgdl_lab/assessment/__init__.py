"""How a surrogate is judged: metrics, figures, tables."""
