"""The input deck of CalculiX: the mesh, material, supports and loads that the solid has.

Lengths are in mm and stresses in Pa, so forces are in µN: CalculiX takes a residual below 1e-6 for zero, whatever the
units, and forces in N are that small in a soft finger.
"""

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.finite_strain import Model

Array = NDArray[np.float64]

# Corners of the faces P1 to P6 of a hexahedron, as places in its list of nodes, which is in the order of VTK.
FACES = np.array([[0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]])

# D2 and D3 of (J − 1)⁴/D2 + (J − 1)⁶/D3, terms that our materials lack: they vanish for a large D, while CalculiX puts
# coefficients of its own in the place of 0.
NO_TERM = 1e20

FIRST_WEIGHT = 0.1  # of the weight
FIRST_PRESSURE = 0.05  # of the highest pressure
SMALLEST_INCREMENT = 1e-5  # of a step
VALUES_IN_A_ROW = 8  # of a card
NO_LIMIT = 1_000_000  # of increments: a step that does not converge ends at the smallest increment

# CalculiX's own tolerance, and what smaller ones need: the iterations after which it looks for divergence, for slow
# convergence, takes a larger residual, and gives an increment up. Its defaults are 4, 8, 9 and 16.
USUAL_TOLERANCE = 0.01
PATIENCE = (8, 60, 60, 120)

# CalculiX takes principal stretches from the roots of the characteristic polynomial of C and divides by their
# differences (its routine rubber.f), so at strains below some 1e-3 a law in them has few digits left. With it the
# weight comes in one increment, if that converges, for strains to be large, and a residual is accepted that is small
# beside the forces of so vague a strain; the last correction is to be smaller instead.
VAGUE_STRAIN = 2.5e-3
CLOSER = 0.1


def weighs(finger: Finger) -> bool:
    """Whether the deck has a step that brings the weight."""
    return bool(np.any(finger.body_force_n_mm3))


def deck(model: Model, finger: Finger, pressures_kpa: Array, tolerance: float) -> str:
    """Text of the deck.

    The first step brings the weight, if there is any, in 1 s. In the last step the pressure rises by 1 kPa in each
    second, so that CalculiX reports its progress in kPa. Displacements are printed at the end of the weight and at
    `pressures_kpa` (P,), the last of which is the highest [kPa].

    Parameters
    ----------
    tolerance
        Largest last correction of an increment as a fraction of the increment [–]; twice the residual as a fraction
        of the average force.

    Raises
    ------
    InputError
        When CalculiX does not have the finger's material.
    """
    domain = model.domain()
    card, highest = finger.material.calculix(), float(pressures_kpa[-1])
    compressibility = 2e-6 / finger.material.bulk_modulus_mpa  # the term (J − 1)²/D1 [1/Pa]
    constants = [*card.constants, compressibility, *[NO_TERM] * (card.volumetric_terms - 1)]
    lines = ["*NODE,NSET=BODY", *(_row(number, *place) for number, place in enumerate(domain.points_mm, start=1))]
    lines.append("*ELEMENT,TYPE=C3D20R,ELSET=BODY")
    for number, nodes in enumerate(domain.cells + 1, start=1):
        lines += [_row(number, *nodes[:10]) + ",", _row(*nodes[10:])]
    lines += [
        "*MATERIAL,NAME=SOLID",
        f"*HYPERELASTIC,{card.form}",
        *(_row(*constants[at : at + VALUES_IN_A_ROW]) for at in range(0, len(constants), VALUES_IN_A_ROW)),
        "*DENSITY",
        _row(1e-6 * finger.density_kg_m3),
        "*SOLID SECTION,ELSET=BODY,MATERIAL=SOLID",
        "*BOUNDARY",
        *(_row(node + 1, component + 1, component + 1) for node, component in np.argwhere(~model.equilibrium.free)),
        "*TIME POINTS,NAME=OBSERVED",
        *(_row(kpa) + "," for kpa in pressures_kpa),
    ]
    face_mm2 = float(model.discretisation.weights.sum() / len(domain.cells)) ** (2 / 3)
    force = VAGUE_STRAIN * 1e6 * finger.material.shear_modulus_mpa * face_mm2 if card.principal else 0.0
    if weighs(finger):
        size = float(np.linalg.norm(finger.gravity_mm_s2))
        weight = _row("BODY", "GRAV", size, *finger.gravity_mm_s2 / size)
        first = 1.0 if card.principal else FIRST_WEIGHT
        lines += _step(1.0, first, tolerance, [weight], f"FREQUENCY={NO_LIMIT}", force)
    first = min(float(pressures_kpa[0]), FIRST_PRESSURE * highest)
    walls = [_row(element, f"P{face}", 1e3 * highest) for element, face in walls_under_pressure(model, domain.cells)]
    lines += _step(highest, first / highest, tolerance, walls, "TIME POINTS=OBSERVED", force)
    return "\n".join(lines) + "\n"


def walls_under_pressure(model: Model, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Element and face number (W, 2), both counted from 1, of each cavity wall, for `cells` (E, 20) in VTK's order."""
    mesh, vertices = model.mesh, model.discretisation.basis.nodal_dofs[0]
    facets = np.asarray(mesh.boundaries["cavity"])
    elements = mesh.f2t[0, facets]
    wanted = np.sort(vertices[mesh.facets[:, facets]].T, axis=1)
    same = (np.sort(cells[elements][:, FACES], axis=2) == wanted[:, None]).all(axis=2)
    return np.column_stack([elements, same.argmax(axis=1)]) + 1


def _step(duration_s: float, first: float, tolerance: float, load: list[str], when: str, force: float) -> list[str]:
    """A quasi-static step that raises `load` evenly over `duration_s` [s] and prints displacements `when` it says.

    Its first increment takes the fraction `first` of it. The residual counts as a fraction of `force` [µN], or of the
    average force where that is 0.
    """
    correction = CLOSER * tolerance if force else tolerance
    lines = [
        f"*STEP,NLGEOM,INC={NO_LIMIT}",
        "*STATIC",
        _row(first * duration_s, duration_s, SMALLEST_INCREMENT * duration_s, duration_s),
        "*CONTROLS,PARAMETERS=FIELD",
        _row(tolerance / 2, correction, 0.0, force),
    ]
    if correction < USUAL_TOLERANCE:
        lines += ["*CONTROLS,PARAMETERS=TIME INCREMENTATION", _row(*PATIENCE)]
    return [*lines, "*DLOAD", *load, f"*NODE PRINT,NSET=BODY,{when}", "U", "*END STEP"]


def _row(*values: object) -> str:
    """Values with commas between them; CalculiX reads at most 20 characters of a number."""
    return ",".join(f"{value:.12g}" if isinstance(value, float) else str(value) for value in values)
