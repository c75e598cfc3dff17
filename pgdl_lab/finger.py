"""The plugin kind `finger`: a soft body, its material and its loads."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from pgdl_lab.mechanics.body import Body
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.mechanics.profile import Profile


@dataclass(frozen=True)
class Finger(ABC):
    """A pneumatic soft finger, clamped at x = 0, bending in the x–z plane.

    Attributes
    ----------
    max_kpa
        Highest air pressure of the simulation [kPa].
    gravity_m_s2
        Acceleration of gravity along x and z [m/s²].
    density_kg_m3
        Mass density of the undeformed material [kg/m³].
    material
        The hyperelastic law.
    """

    max_kpa: float = 50.0
    gravity_m_s2: list[float] = field(default_factory=lambda: [0.0, -9.81])
    density_kg_m3: float = 1130.0
    material: Yeoh = field(default_factory=Yeoh)

    @abstractmethod
    def body(self, edge_mm: float) -> Body:
        """Mesh of the half finger (y ≥ 0) with element edges of at most `edge_mm` [mm]."""


@dataclass(frozen=True)
class ExtrudedFinger(Finger):
    """A finger whose body is one x–z profile extruded along y, closed by side walls.

    Attributes
    ----------
    width_mm
        Full width along y [mm].
    side_wall_mm
        Thickness of the two side walls that close the cavities [mm].
    """

    width_mm: float = 16.0
    side_wall_mm: float = 3.0

    @abstractmethod
    def profile(self) -> Profile:
        """The x–z section through the cavities, with regions solid, cavity and gap."""
