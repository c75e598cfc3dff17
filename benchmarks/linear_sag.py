"""Discretisation error of the elements: sag of the finger's tip in a linear solve, by element and mesh.

    python benchmarks/linear_sag.py

The last rows are what the others converge to. The sag per unit of gravity is a linear measure: it is no displacement
that the finger ever has.
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from pgdl_lab import registry
from pgdl_lab.mechanics.equilibrium import Load
from pgdl_lab.mechanics.finite_strain import Model

CASES = [("hex20", 3.0), ("hex27", 3.0), ("hex27_p0", 3.0), ("hex27_p1", 3.0), ("hex20", 1.5), ("hex27_p1", 1.5)]


def main() -> None:
    """Print the table."""
    registry.discover()
    finger = registry.plugin("finger", "pneunet")()
    table = Table(title="Linear sag of pneunet under its weight")
    for column in ("element", "edge (mm)", "unknowns", "sag (mm)", "against the last", "seconds"):
        table.add_column(column, justify="right")
    rows = []
    for element, edge_mm in CASES:
        began = time.perf_counter()
        model = Model(finger, edge_mm, element)
        sag = np.zeros_like(model.equilibrium.weight)
        balance = model.equilibrium.balance(sag, Load(1.0, 0.0), stiffness=True)
        assert balance.stiffness is not None
        model.solver.factorise(balance.stiffness)
        sag[model.equilibrium.free] = -model.solver.solve(balance.forces[model.equilibrium.free])
        model.solver.close()
        rows.append((element, edge_mm, model.equilibrium.free.sum(), sag[:, 2].min(), time.perf_counter() - began))
    reference = rows[-1][3]
    for element, edge_mm, unknowns, lowest, seconds in rows:
        error = f"{100 * (lowest / reference - 1):+.1f} %"
        table.add_row(element, f"{edge_mm:g}", f"{unknowns:,}", f"{lowest:.2f}", error, f"{seconds:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
