"""The plugin kind `finger`: a soft body, its material and its loads."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.mechanics.cavity import Cavity
from pgdl_lab.mechanics.face import Face, observe
from pgdl_lab.mechanics.material import Material, Yeoh
from pgdl_lab.mechanics.profile import Profile
from pgdl_lab.mechanics.term import DeadLoad, Ramp, Schedule, Term

if TYPE_CHECKING:
    from skfem import Mesh, MeshHex

    from pgdl_lab.mechanics.elements import Discretisation

STANDARD_GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Finger(ABC):
    """A pneumatic soft finger, clamped at x = 0, bending in the x–z plane, its body symmetric about y = 0.

    Attributes
    ----------
    max_kpa
        Highest air pressure of the simulation [kPa].
    gravity_m_s2
        Acceleration of gravity along x and z, or along x, y and z [m/s²].
    density_kg_m3
        Mass density of the undeformed material [kg/m³].
    material
        The hyperelastic law.
    open_mm
        Dimensions that nothing but a calibration determines (`sweep=calibrate`), and the range of each [mm].
    """

    open_mm: ClassVar[Mapping[str, tuple[float, float]]] = {}

    max_kpa: float = 50.0
    gravity_m_s2: list[float] = field(default_factory=lambda: [0.0, -9.81])
    density_kg_m3: float = 1130.0
    material: Material = field(default_factory=Yeoh)

    def __post_init__(self) -> None:
        if not 0 < self.max_kpa < np.inf:
            raise InputError(f"finger.max_kpa is {self.max_kpa} kPa; it must be a positive pressure.")
        if not 0 <= self.density_kg_m3 < np.inf:
            raise InputError(f"finger.density_kg_m3 is {self.density_kg_m3} kg/m³; it must not be negative.")
        if len(self.gravity_m_s2) not in (2, 3) or not np.isfinite(self.gravity_m_s2).all():
            raise InputError(
                f"finger.gravity_m_s2 is {self.gravity_m_s2}; give its x and z components in m/s², e.g. [0,-9.81], or "
                "x, y and z, e.g. [0,9.81,0]."
            )

    @property
    def gravity_mm_s2(self) -> NDArray[np.float64]:
        """Acceleration of gravity along x, y and z (3,) [mm/s²]."""
        x, *y, z = self.gravity_m_s2
        return 1e3 * np.array([x, y[0] if y else 0.0, z], dtype=np.float64)

    @property
    def body_force_n_mm3(self) -> NDArray[np.float64]:
        """Weight per undeformed volume along x, y and z (3,) [N/mm³]."""
        return self.density_kg_m3 * 1e-12 * self.gravity_mm_s2

    @property
    def planar(self) -> bool:
        """Whether the load keeps the symmetry about y = 0, so that half a finger tells of the whole."""
        return bool(self.gravity_mm_s2[1] == 0)

    def files(self) -> Sequence[Path]:
        """Files that determine the finger together with its fields."""
        return ()

    def content(self) -> Iterable[bytes | NDArray[Any]]:
        """What these files hold: results are kept under it."""
        return (path.read_bytes() for path in self.files())

    def finer(self, edge_mm: float) -> str:
        """What to do for a finer mesh than one with edges of `edge_mm` [mm], in words for a message."""
        return f"lower fem.edge_mm={edge_mm:g}"

    def whole(self) -> str:
        """How to have both halves simulated, in words for a message.

        A pull across of 1/10,000 of the weight makes a finger lean over that gives way sideways.
        """
        x, z = self.gravity_m_s2[0], self.gravity_m_s2[-1]
        across = 1e-4 * (float(np.hypot(x, z)) or STANDARD_GRAVITY_M_S2)
        return f"with a pull across that is next to nothing, finger.gravity_m_s2=[{x},{across:.3g},{z}]"

    def loads(self, body: "Discretisation") -> dict[str, Term]:
        """What acts on the finger, by name: its weight, and the air [MPa] in its cavities.

        Parameters
        ----------
        body
            The elements that it acts on; those of half a finger stand for both, with loads that are mirror images.
        """
        return {"air": Cavity(body.basis), "weight": DeadLoad.weight(body, self.body_force_n_mm3)}

    def schedules(self) -> tuple[Schedule, Schedule]:
        """How much of its loads acts: as they are put on, by a parameter from 0 to 1, and at each pressure [kPa]."""
        weight = {"weight": 1.0}
        return Ramp(weight), Ramp({"air": 1e-3}, held=weight)

    def doubts(self) -> Sequence[str]:
        """What about the body may not be as meant, in sentences that go with every result."""
        return ()

    @abstractmethod
    def mesh(self, edge_mm: float) -> "Mesh":
        """Mesh of the half finger y ≥ 0, or of the whole one unless `planar` [mm]; edges of some `edge_mm` [mm].

        Its named boundaries are `clamp` (held fixed), `symmetry` (y = 0) and `cavity` (under pressure); one without
        `symmetry` is that of the whole finger.
        """

    @abstractmethod
    def face(self, points: int) -> Face:
        """The observed side face, that of the largest y, with `points` points."""


@dataclass(frozen=True)
class ExtrudedFinger(Finger):
    """A finger whose body is one x–z profile extruded along y, with side walls that close the cavities.

    Attributes
    ----------
    width_mm
        Full width along y [mm].
    side_wall_mm
        Thickness of each of the two side walls [mm].
    """

    width_mm: float = 16.0
    side_wall_mm: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.side_wall_mm <= 0 or self.width_mm <= 2 * self.side_wall_mm:
            raise InputError(
                f"finger.side_wall_mm is {self.side_wall_mm} mm; it must be above 0 and below half of finger.width_mm "
                f"({self.width_mm / 2} mm), else there is no cavity."
            )

    def _require_positive(self, *names: str, zero: bool = False) -> None:
        """Check that the lengths `names` are positive, or `zero` at least; raises InputError."""
        for name in names:
            value = getattr(self, name)
            if not (0 < value < np.inf or (zero and value == 0)):
                raise InputError(f"finger.{name} is {value} mm; it must {'not be negative' if zero else 'be above 0'}.")

    @abstractmethod
    def profile(self) -> Profile:
        """The x–z section through the cavities."""

    def mesh(self, edge_mm: float) -> "MeshHex":
        from pgdl_lab.mechanics.extrude import extrude

        return extrude(self.profile(), self.width_mm / 2, self.side_wall_mm, edge_mm, whole=not self.planar)

    def face(self, points: int) -> Face:
        return observe(self.profile(), points, self.width_mm / 2)
