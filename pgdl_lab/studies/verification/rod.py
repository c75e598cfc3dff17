"""The rod against closed forms, and its segments against the textbooks of prismatic bars."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.registry import plugin
from pgdl_lab.mechanics.equilibrium import Equilibrium
from pgdl_lab.mechanics.finger import ExtrudedFinger
from pgdl_lab.mechanics.finger_rod import FingerRod
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.profile import Profile, Region
from pgdl_lab.mechanics.rod import Axis, rod
from pgdl_lab.mechanics.segments import solve
from pgdl_lab.mechanics.term import DeadLoad, Ramp
from pgdl_lab.studies.verification.benchmark import Check, benchmark
from pgdl_lab.studies.verification.bodies import raise_load, settle
from pgdl_lab.studies.verification.elastica import LOADS, elastica

Array = NDArray[np.float64]

LENGTH_MM, BENDING_N_MM2 = 100.0, 1000.0
ELEMENTS = 200
# Stretch and shear are 10⁻⁶ of what bending does: what is left is the error of the elements, about (κ h)² / 24.
AXIAL_N = 1e6 * BENDING_N_MM2 / LENGTH_MM**2


def cantilever(mass: float, gravity: float) -> Equilibrium:
    """A uniform cantilever that hardly stretches, of `mass` [tonne] under `gravity` along z [mm/s²]."""
    one = np.ones(ELEMENTS)
    stiffness = one[:, None, None] * np.diag([AXIAL_N, AXIAL_N, BENDING_N_MM2])
    axis, no_air = Axis(np.linspace(0, LENGTH_MM, ELEMENTS + 1)), np.zeros((ELEMENTS, 3))
    return rod(axis, stiffness, no_air, mass / ELEMENTS * one, 0 * one, np.array([0.0, gravity]))


def loaded(bent: Equilibrium, *load: float) -> Equilibrium:
    """`bent` with the dead load "end" at its tip: forces along x and z [N] and a moment from x to z [N mm]."""
    forces = np.zeros(bent.free.shape)
    forces[-1] = load
    return bent.with_terms(end=DeadLoad(forces))


@benchmark("rod, dead load at the tip", quick=True)
def tip_load(quick: bool) -> Iterator[Check]:
    """Deflection and shortening as the load rises."""
    bent = loaded(cantilever(0.0, 0.0), 0.0, BENDING_N_MM2 / LENGTH_MM**2, 0.0)
    branch = raise_load(bent, Ramp({"end": 1.0}), LOADS[-1], 0.2)
    for load in LOADS:
        u, w, _ = branch.at(load)[-1] / LENGTH_MM
        for name, reference, obtained in zip(("w/L", "u/L"), elastica(load), (w, -u), strict=True):
            yield Check(
                f"P L²/(E I) = {load:g}: {name} [–]", reference, float(obtained), 2e-4,
                "elliptic integrals (Bisshopp and Drucker 1945)",
            )  # fmt: skip


@benchmark("rod, end moment to a closed circle", quick=True)
def circle(quick: bool) -> Iterator[Check]:
    """M = 2 π E I / L brings the tip back to the root; the elements become the sides of a polygon that closes."""
    bent = loaded(cantilever(0.0, 0.0), 0.0, 0.0, 2 * np.pi * BENDING_N_MM2 / LENGTH_MM)
    branch = raise_load(bent, Ramp({"end": 1.0}), 1.0, 0.05)
    u, w, turned = branch.displacements[-1][-1]
    yield Check(
        "distance of tip and root over length [–]", 0.0, float(np.hypot(LENGTH_MM + u, w) / LENGTH_MM), 1e-6, "circle"
    )
    yield Check("rotation of the tip [rad]", 2 * np.pi, float(turned), 1e-6, "M = E I κ")
    top = float(branch.displacements[-1][ELEMENTS // 2, 1] / LENGTH_MM)
    yield Check("diameter over length [–]", 1 / np.pi, top, 2e-4, "circle")


def weighed_down(load: float) -> tuple[float, float]:
    """Sag and shortening over length of an inextensible cantilever under its weight, for `load` = q L³ / (E I).

    E I φ'' = −q (L − s) cos φ with φ(0) = 0 and φ'(L) = 0 (F. V. Rohde, Quarterly of Applied Mathematics 11, 1953), by
    collocation.
    """
    from scipy.integrate import solve_bvp

    s = np.linspace(0, 1, 101)

    def slopes(s: Array, y: Array) -> Array:
        return np.array([y[1], -load * (1 - s) * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    solution = solve_bvp(slopes, ends, s, np.zeros((4, len(s))), tol=1e-9, max_nodes=10000)
    return float(solution.y[2, -1]), float(1 - solution.y[3, -1])


@benchmark("rod, own weight", quick=True)
def own_weight(quick: bool) -> Iterator[Check]:
    """Sag and shortening of the tip."""
    unit = BENDING_N_MM2 / LENGTH_MM**3  # weight per length with q L³ / (E I) = 1 [N/mm]
    branch = raise_load(cantilever(unit * LENGTH_MM / 9810, 9810.0), Ramp({"weight": 1.0}), 10.0, 0.2)
    for load in (1.0, 4.0, 10.0):
        u, w, _ = branch.at(load)[-1] / LENGTH_MM
        for name, reference, obtained in zip(("w/L", "u/L"), weighed_down(load), (w, -u), strict=True):
            yield Check(
                f"q L³/(E I) = {load:g}: {name} [–]", reference, float(obtained), 2e-4, "Rohde 1953, by collocation"
            )


@benchmark("segments of a rod", quick=True)
def prismatic(quick: bool) -> Iterator[Check]:
    """A full bar and a bored one: the displacements of pure tension and bending are quadratic, the elements exact."""
    finger = plugin("finger", "pneunet")()
    width, bore, law = finger.width_mm, finger.width_mm - 2 * finger.side_wall_mm, finger.material
    young = 2 * law.shear_modulus_mpa * (1 + law.poisson)
    z, axis = np.array([0.0, 3.0, 7.0, 9.0]), 4.0
    heights, middles = np.diff(z), (z[1:] + z[:-1]) / 2 - axis
    for name, region in (("full", Region.SOLID), ("bored", Region.CAVITY)):
        piece = Profile(np.array([0.0, 6.0]), z, np.array([[Region.SOLID, region, Region.SOLID]], dtype=np.int8))
        hole = bore * heights[1] * (region == Region.CAVITY)
        area = width * heights.sum() - hole
        inertia = width * (heights * (middles**2 + heights**2 / 12)).sum() - hole * (
            middles[1] ** 2 + heights[1] ** 2 / 12
        )
        segment = solve(finger, piece, False, 3.0, axis)
        figures = [
            ("E A [N]", young * area, segment.stiffness[0, 0]),
            ("E I about the axis [N mm²]", young * inertia, segment.stiffness[1, 1]),
        ]
        if hole:
            push = (1 - 2 * law.poisson) * hole
            figures += [
                ("force of the air per pressure [mm²]", push, segment.air[0]),
                ("its moment [mm³]", -push * middles[1], segment.air[1]),
            ]
        for what, reference, obtained in figures:
            yield Check(
                f"{name}: {what}", float(reference), float(obtained), 1e-6 * float(abs(reference)), "bar theory"
            )


@dataclass(frozen=True)
class Bar(ExtrudedFinger):
    """A bar without weight, full or with a closed bore."""

    density_kg_m3: float = 0.0
    width_mm: float = 10.0
    length_mm: float = 12.0
    z_mm: tuple[float, ...] = (0.0, 6.0)
    bored: bool = False

    def profile(self) -> Profile:
        solid = [Region.SOLID] * (len(self.z_mm) - 1)
        middle = [Region.SOLID, Region.CAVITY, Region.SOLID] if self.bored else solid
        wall = 6.0 if self.bored else 0.0
        return Profile.from_columns(self.z_mm, [(wall, solid), (self.length_mm - 2 * wall, middle), (wall, solid)])


@benchmark("bar as a rod, load at the tip", quick=True)
def short_bar(quick: bool) -> Iterator[Check]:
    """A bar twice as long as high, of whose sag 15 % are shear; without Poisson's effect the clamp holds nothing."""
    bar, load = Bar(material=Yeoh(poisson=0.0)), 1e-4
    bent = loaded(FingerRod(bar, 3.0, 0.25).equilibrium, 0.0, load, 0.0)
    height, shear = bar.z_mm[-1], bar.material.shear_modulus_mpa
    bending = load * bar.length_mm**3 / (3 * 2 * shear * bar.width_mm * height**3 / 12)
    sag = bending + load * bar.length_mm / (5 / 6 * shear * bar.width_mm * height)
    found = float(settle(bent, np.zeros(bent.free.shape), {"end": 1.0})[-1, 1])
    yield Check("deflection [mm]", sag, found, 1e-3 * sag, "S. P. Timoshenko 1921, with 5/6 for a rectangle")


@benchmark("bored bar as a rod, pressure", quick=True)
def bored_bar(quick: bool) -> Iterator[Check]:
    """What a bar with a closed bore above its middle turns by more when it is longer: its ends no longer matter."""
    turned, pressure = [], 1e-5
    for length in (36.0, 48.0):
        bar = Bar(length_mm=length, z_mm=(0.0, 3.0, 7.0, 9.0), bored=True, material=Yeoh(poisson=0.3))
        blown = FingerRod(bar, 3.0, 1.0).equilibrium
        turned.append(settle(blown, np.zeros(blown.free.shape), {"air": pressure})[-1, 2])
    bore = (bar.width_mm - 2 * bar.side_wall_mm) * 4.0
    area = bar.width_mm * 9.0 - bore
    centre = (bar.width_mm * 9.0 * 4.5 - bore * 5.0) / area
    inertia = bar.width_mm * (9.0**3 / 12 + 9.0 * (4.5 - centre) ** 2) - bore * (4.0**2 / 12 + (5.0 - centre) ** 2)
    young = 2 * bar.material.shear_modulus_mpa * 1.3
    curvature = -pressure * (1 - 2 * 0.3) * bore * (5.0 - centre) / (young * inertia)
    found = float(turned[1] - turned[0]) / 12.0
    yield Check("curvature [1/mm]", curvature, found, 1e-4 * abs(curvature), "bar theory, walls that pull at the ends")
