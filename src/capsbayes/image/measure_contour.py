"""From a contour that another program traced to a measurement."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.files.contour import ContourFile
from capsbayes.image.measure import FLOWS, check_flow, measurement_of_lengths
from capsbayes.measurement import Measurement
from capsbayes.profile import Profile, signed_area, vertex_normals
from capsbayes.quantity import Quantity

POINTS = ("centres", "borders")
_HALF_PIXEL = 0.45  # px: how far inside the edge a polygon through the centres of the outermost pixels lies, on average
_CONCAVE = 3.0  # of the edge's error: a rear that is hollow by more is taken to have been traced


def measure_contour(
    contour: ContourFile,
    experiment: Experiment,
    *,
    capsule_velocity: Quantity,
    edge_error: Quantity,
    flow: str,
    pixel_size: Quantity | None = None,
    points: str | None = None,
) -> Measurement:
    """Measure a capsule from its contour.

    Parameters
    ----------
    contour : ContourFile
    experiment : Experiment
    capsule_velocity : Quantity [m/s]
        v_o with its standard error.
    edge_error : Quantity [m]
        Standard error of either end of the contour; the value is used, not its error.
    flow : str
        ``"right"`` or ``"left"``.
    pixel_size : Quantity, optional [m]
        Of a contour in pixels, with its standard error.
    points : str, optional
        Of a contour in whole pixels: ``"centres"`` if it runs through the centres of pixels, half a pixel inside the
        edge; ``"borders"`` if it runs along their borders.

    Returns
    -------
    Measurement
        Lengths in metres. L_a is that of the contour if its rear is concave by more than three errors of the edge;
        otherwise it is missing, as the rim may hide a concave rear, and has an upper bound.

    Raises
    ------
    InputError
        If an option is missing that the file does not tell.
    """
    direction = FLOWS[flow] if check_flow(flow) else 1
    unit, outline = _edge(contour, pixel_size, points)
    z, y = direction * outline[:, 0], outline[:, 1]
    centred = np.stack([z, y - 0.5 * (y.max() + y.min())], axis=1)
    profile = Profile.from_outline(centred)
    error = edge_error.value / unit.value
    depth = profile.parachute_depth if profile.parachute_depth > _CONCAVE * error else np.nan
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = error**2 * np.array([[2.0, 1.0], [1.0, 2.0]])  # both lengths end at the nose
    return measurement_of_lengths(
        np.array([profile.axial_extent, profile.axial_extent - depth, depth, np.nan]),
        covariance,
        capsule_velocity,
        experiment,
        pixel_size=unit,
        source=contour.source,
        sha256=contour.sha256,
    )


def _edge(contour: ContourFile, pixel_size: Quantity | None, points: str | None) -> tuple[Quantity, Floats]:
    """Return the length of the contour's unit, and the edge in that unit."""
    outline = contour.points if signed_area(contour.points) > 0.0 else contour.points[::-1]
    if contour.unit == "um":
        return Quantity(1e-6, 0.0, "m"), outline
    if pixel_size is None or pixel_size.error == 0.0:
        raise InputError(contour.source, "pixel size", "one with an error for points in pixels", "nothing")
    if np.array_equal(outline, np.rint(outline)) and points not in POINTS:
        expected = "whether these whole pixels are centres of pixels or borders between them"
        raise InputError(contour.source, "points", expected, repr(points), "say centres or borders")
    if points == "centres":
        outline = outline + _HALF_PIXEL * vertex_normals(outline)
    return pixel_size, outline
