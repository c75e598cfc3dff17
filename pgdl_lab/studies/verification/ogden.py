"""Ogden's solid where it is one of the others."""

from collections.abc import Iterator

import numpy as np

from pgdl_lab.core.registry import plugin
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import body, wavy


@benchmark("special cases of Ogden's solid", quick=True)
def ogden(quick: bool) -> Iterator[Check]:
    """Forces and stiffness of a cube, displaced at random, beside those of the solid that has the same energy."""
    law, mooney_rivlin = plugin("material", "ogden"), plugin("material", "mooney_rivlin")
    cases: list[tuple[str, Material, Material]] = [
        ("α = 2, neo-Hooke", law([0.22], [2.0]), Yeoh(c1_mpa=0.11, c2_mpa=0.0)),
        ("α = 2 and −2, Mooney–Rivlin", law([0.18, -0.04], [2.0, -2.0]), mooney_rivlin(0.09, 0.02)),
    ]
    for name, *pair in cases:
        solids = [body(wavy(2, "hex27_p1"), "hex27_p1", material, {}).solid for material in pair]
        positions = solids[0].discretisation.positions
        at = 0.2 * positions[:, [1, 2, 0]] + 0.01 * np.random.default_rng(0).normal(size=positions.shape)
        ours, peer = (solid.response(at, stiffness=True) for solid in solids)
        assert ours.stiffness is not None and peer.stiffness is not None
        for what, obtained, reference in (
            ("forces", ours.forces, peer.forces),
            ("stiffness", ours.stiffness, peer.stiffness),
        ):
            error = float(np.abs(obtained - reference).max() / np.abs(reference).max())
            yield Check(f"{name}: error of {what} [–]", 0.0, error, 1e-12, "the other solid")
