"""The shape of a simulated capsule: nodes, outlines, and a file for ParaView."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.files.output_file import refusing, write_file
from capsbayes.physics.capsule import outlines
from capsbayes.physics.stokes.channel import Channel
from capsbayes.physics.stokes.cross_sections import cross_section_named
from capsbayes.physics.surface.octasphere import OctaSphere, octasphere
from capsbayes.profile import Profile


@dataclass(frozen=True, eq=False)
class Shape:
    """A capsule in its channel. Lengths over l, velocities over U."""

    capillary_number: float
    size_ratio: float
    settings: Mapping[str, Any]
    nodes: Floats  # (w, 3) of the wedge 0 <= y <= x, or 0 <= x, y; flow along z, centroid at the origin
    velocity_ratio: float  # velocity of the centroid v_o / U

    @property
    def channel(self) -> Channel:
        """The channel that the capsule is in."""
        known = self.settings
        return cross_section_named(known["cross_section"], known["corner_radius"], known["section_aspect"])

    @property
    def mesh(self) -> OctaSphere:
        """Mesh of the unit sphere to whose wedge the nodes belong."""
        return octasphere(self.settings["refinement"], self.channel.symmetry)

    @property
    def surface_nodes(self) -> Floats:
        """All nodes of the membrane (N, 3) [l]."""
        mesh = self.mesh
        return np.einsum("nij,nj->ni", mesh.operation, self.nodes[mesh.wedge_of])

    @property
    def profile(self) -> Profile:
        """Outline in the plane x = 0 [l]."""
        return outlines.profile(self.mesh, self.surface_nodes)

    @property
    def silhouette(self) -> Profile:
        """Outline of the whole capsule seen along x [l]."""
        return outlines.silhouette(self.mesh, self.surface_nodes)

    @property
    def point_data(self) -> dict[str, Floats]:
        """Values (N,) at the nodes that are saved with the shape, by the names that ParaView shows."""
        return {}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the membrane as a VTK unstructured grid (``.vtu``) of quadratic triangles, for ParaView."""
        import meshio

        path = Path(path)
        if path.suffix != ".vtu":
            raise InputError(str(path), "", "a file name that ends in .vtu", repr(path.suffix))
        mesh = meshio.Mesh(self.surface_nodes, [("triangle6", self.mesh.elements)], point_data=self.point_data)
        with refusing(path, "a file that can be written"), tempfile.TemporaryDirectory() as folder:
            mesh.write(Path(folder) / "mesh.vtu")  # meshio writes no other way
            return write_file(path, (Path(folder) / "mesh.vtu").read_bytes())
