"""Small fingers whose simulation takes a second."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from skfem import MeshHex, MeshTet

from pgdl_lab.core import paths, registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.observation import Observation
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger
from pgdl_lab.mechanics.material import Yeoh

registry.discover()

REFERENCE: dict[str, Any] = OmegaConf.to_container(OmegaConf.load(paths.CONF / "finger" / "pneunet_reference.yaml"))
del REFERENCE["defaults"]
OBSERVATION = Observation(snapshots=10, points=800)


def pneunet(**fields: Any) -> Finger:
    """The reference finger, but of two chambers and up to 20 kPa, or with other `fields`."""
    finger: Finger = registry.plugin("finger", "pneunet")(**{**REFERENCE, "chambers": 2, "max_kpa": 20.0, **fields})
    return finger


def solid(**fields: Any) -> Fem:
    """A coarse mesh of 20-node elements whose error nobody asks for, or with other `fields`."""
    given = {"edge_mm": 6.0, "element": "hex20", "estimate_error": False, **fields}
    fem: Fem = registry.plugin("fem", "solid")(**given)
    return fem


def tetrahedra(mesh: MeshHex) -> MeshTet:
    """Six tetrahedra for each hexahedron that is a box, with the same named boundaries."""
    around = [[0, 1, 4, 7], [0, 1, 5, 7], [0, 2, 4, 7], [0, 2, 6, 7], [0, 3, 5, 7], [0, 3, 6, 7]]  # one diagonal
    split = MeshTet(mesh.p, np.hstack([mesh.t[corners] for corners in around]))
    facets = split.boundary_facets()
    corners = split.facets[:, facets]
    named = {}
    for name, faces in mesh.boundaries.items():
        inside = [np.isin(corners, mesh.facets[:, face]).all(axis=0) for face in faces]
        named[name] = facets[np.any(inside, axis=0)]
    return split.with_boundaries(named)


def balloon() -> Finger:
    """A finger of neo-Hooke material that bursts far below its highest pressure."""
    return replace(pneunet(chambers=1, max_kpa=300.0), material=Yeoh(c2_mpa=0.0))


def from_file(path: Path, **fields: Any) -> Finger:
    """A finger from a mesh file, up to 1 kPa, or with other `fields`."""
    finger: Finger = registry.plugin("finger", "mesh")(**{"path": str(path), "max_kpa": 1.0, **fields})
    return finger


def refusal(path: Path, **fields: Any) -> str:
    """The one line with which a mesh file is refused."""
    try:
        from_file(path, **fields).mesh(1.0)
    except InputError as error:
        assert "\n" not in str(error)
        return str(error)
    raise AssertionError(f"{path} was taken")
