"""Prolong fields from one symmetric mesh of the sphere to another."""

from __future__ import annotations

from scipy.interpolate import RBFInterpolator

from capsbayes.arrays import Floats
from capsbayes.physics.surface.octasphere import OctaSphere

_NEIGHBOURS = 80


def prolonged(free: Floats, coarse: OctaSphere, fine: OctaSphere) -> Floats:
    """Return the free coordinates on `fine` of the symmetric field with free coordinates `free` on `coarse`.

    The field is interpolated smoothly: the kinks of P2 interpolation at the coarse elements' edges would strain
    the fine ones by more than Newton's iteration recovers from.
    """
    if coarse is fine:
        return free
    field = RBFInterpolator(coarse.nodes, coarse.expanded(free), kernel="cubic", degree=1, neighbors=_NEIGHBOURS)
    return fine.reduced(field(fine.nodes[fine.wedge]))
