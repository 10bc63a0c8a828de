"""Lengths and outline of the capsule in a picture, with their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d

from capsbayes.arguments import checked
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Camera, Experiment
from capsbayes.files.csv_file import text_of_numbers
from capsbayes.files.output_file import together, write_file
from capsbayes.footing import on_mirror
from capsbayes.image.background import (
    CONTRAST,
    FAINTEST,
    Contrast,
    are_misplaced,
    check_light,
    check_place,
    compared_with_bands,
    edge_shift,
    estimate_background,
    falling_light,
    find_blobs,
    is_shadow,
    runs_upright,
    transmission,
)
from capsbayes.image.by_hand import ByHand
from capsbayes.image.detect import Detection, analyse_blob
from capsbayes.image.edge_models import quantile
from capsbayes.image.edges import ARC, pixel_noise, scatter_expected, thinned, without_erased
from capsbayes.image.files import Picture
from capsbayes.image.motion import smeared
from capsbayes.image.overlay import write_overlay
from capsbayes.image.walls import WallLines, find_walls
from capsbayes.measurement import (
    FEWEST_POINTS,
    MOST_ASKEW,
    SILHOUETTE,
    MeasuredOutline,
    Measurement,
    OutlineNoise,
    Pose,
    askew_size,
)
from capsbayes.quantity import Given, Quantity
from capsbayes.status import Status

# The silhouette over l: means of three points, whose errors are almost independent. Their scatter, errors alike along
# the edge and an offset follow from the errors with which the edge was located, by factors set on drawn pictures other
# than those whose coverage is counted. A rear that is a band much wider than the nose has an error of its own

_ARC_SHARE = 0.6  # of an arc's error that is in its points
_MISFIT = 0.024  # 1/px: error along the edge over the square of its width
_OF_SHIFT = 0.5  # of the error of a smoothed picture's edges, which differ as their dark lines do
_OF_LINE, _OF_REAR = 0.1, 0.5  # of the depth of the edge in a membrane's line, into which that of a concave rear runs
_FACING = 0.8  # cosine of a normal's angle to the channel, least at the ends
_BAND = 1.5  # of the square of the width at the nose: in drawn pictures that at the rear is 0.8 to 1.35 of it


@dataclass(frozen=True)
class EdgeErrors:
    """Standard deviations of the errors of a silhouette's points along their normals [px]."""

    scatter: float  # of means of three points, independent of each other and in each picture
    arc: float  # alike along an arc, and independent in each picture
    misfit: float  # alike along an arc, and the same in all pictures of a capsule: that of the edge's model
    offset: float  # alike all around, and the same in all pictures of a capsule
    rear: float = 0.0  # of the rear, along the flow, and the same in all pictures of a capsule
    alike: float = ARC  # length of an arc

    @classmethod
    def of(cls, detection: Detection) -> EdgeErrors:
        """Return the errors that follow from those with which the outline of a detection was located."""
        walls, outline = detection.located()
        kept = ~outline.erased
        width = np.square(outline.edge_width[kept])
        arc = _ARC_SHARE * np.sqrt(np.mean(np.square(outline.arc_error[kept])))
        misfit = np.hypot(_MISFIT * np.sqrt(np.mean(np.square(width))), _OF_SHIFT * detection.shift)
        misfit = np.hypot(misfit, _OF_LINE * detection.line)
        facing = detection.flow * (outline.normals[kept] @ walls.along)
        nose, rear = (float(np.mean(width[side * facing > _FACING])) if detection.flow else 0.0 for side in (1, -1))
        band = float(np.sqrt(rear - nose)) if rear > _BAND * nose else 0.0
        band = float(np.hypot(band, _OF_REAR * detection.line))
        return cls(scatter_expected(outline), float(arc), float(misfit), detection.offset, band, outline.alike)


def silhouette_of(detection: Detection) -> MeasuredOutline | None:
    """Return the silhouette of a detection, as `identify` compares it with a model's; None where there is none."""
    # points next to a wall lie up to 0.4 of the edge's width too far out
    if not detection.status.ok or detection.flow == 0:
        return None
    walls, outline = detection.located()
    points = thinned(outline.points)
    clear = walls.is_clear(walls.clearance(points)) & without_erased(outline)
    points = points[clear] - detection.axis
    points = np.stack([detection.flow * (points @ walls.along), points @ walls.across], axis=1)
    return over_l(points, EdgeErrors.of(detection), walls.half_width, walls.half_width_error)


def over_l(points: Floats, errors: EdgeErrors, half_width: float, half_width_error: float) -> MeasuredOutline | None:
    """Return the silhouette over l with points (m, 2) along and across the flow [px]; None if they are too few."""
    if len(points) < FEWEST_POINTS:
        return None
    smooth = np.hypot(errors.arc, errors.misfit)  # alike over a length of the edge
    points = points / half_width
    radius = float(np.mean(np.hypot(*(points - points.mean(axis=0)).T)))
    noise = OutlineNoise(
        float(np.hypot(errors.scatter, smooth)) / half_width,
        errors.alike / half_width,
        float(errors.scatter**2 / (errors.scatter**2 + smooth**2)),
    )
    # an error of l changes all radii in proportion, much as an offset does
    offset = np.hypot(errors.offset, radius * half_width_error)
    pose = Pose(offset=float(offset) / half_width, rear=errors.rear / half_width)
    return MeasuredOutline(points, noise, pose, SILHOUETTE)


# Known faults of the camera are taken out about the middle of the picture, taken to be that of the lens on the axis


def _straightened(
    detection: Detection, outline: MeasuredOutline | None, columns: int, camera: Camera
) -> tuple[Detection, MeasuredOutline | None]:
    """Return a detection and its silhouette without the faults of a camera, with their errors."""
    lines, located = detection.located()
    half_width, sense = lines.half_width, detection.flow or 1
    along_across = np.stack([lines.along, lines.across], axis=1) / half_width
    origin = lines.centred_at(0.5 * (columns - 1)).middle
    walls = 1.0 + (0.5 * columns / half_width) ** 2 / 3.0  # mean square of their distance from there, over l^2
    edge = (located.points - origin) @ along_across
    front, back = (edge[np.argmax(side * sense * edge[:, 0])] for side in (1, -1))
    hollow = np.array([front[0] - sense * detection.lengths[1] / half_width, 0.0])
    points = np.array([front, back, hollow])
    true, seen = (np.abs(each[0, 0] - each[1:, 0]) for each in (camera.straightened(points, walls=walls), points))
    errors = camera.errors_of(points, walls=walls)
    off = half_width * (errors[:, :1, 0] - errors[:, 1:, 0])
    corrected = replace(detection, factors=true / seen, further=off.T @ off)
    if outline is None:
        return corrected, None
    flow = [sense, 1]
    middle = (detection.axis - origin) @ along_across * flow
    places = camera.straightened((outline.points + middle) * flow, walls=walls) * flow
    pose = replace(
        outline.pose,
        **{name: value.sd for name, value in camera.stated.items()},
        middle=float(0.5 * (places[:, 0].max() + places[:, 0].min())),
        walls=walls,
    )
    return corrected, replace(outline, points=places - middle, pose=pose)


# The capsule in one picture: its lengths, their errors, and the edges that they were read from

Source = str | Path | ArrayLike
FLOWS = {"right": 1, "left": -1}
_NEAR = 3.0  # px: nearer to a dead column, an end of the capsule is not located
_FRINGE = 0.1  # of the darkness at an edge: brighter fringes are told
CLIPPED = 0.02  # largest share of clipped pixels between the walls


def detect(
    picture: Picture,
    *,
    background: Picture | None = None,
    flow: str | None = None,
    by_hand: ByHand | None = None,
    half_width: Given | None = None,
    camera: Camera | None = None,
) -> Detection:
    """Find the walls, the capsule and its concave rear in a picture; lengths are without the faults of the camera.

    A capsule that is not symmetric about the flow is refused (``LOPSIDED``, or ``DOUBLET`` where something juts out).
    """
    direction = check_flow(flow)
    picture, background, by_hand = turned(picture, background, by_hand)
    if background is not None and background.shape != picture.shape:
        return Detection(Status.BACKGROUND_DIFFERS)
    width = None if half_width is None else Quantity.of(half_width, "half_width", where="detect")
    rows, columns = part = by_hand.part(picture.shape)
    stated = by_hand.lines(picture.shape, width)
    seen, empty = picture.cut(part), background and background.cut(part)
    if empty is not None:
        check_light(seen, empty)
    contrast = Contrast.of([seen.grey], None if empty is None else empty.grey, stated, by_hand.contrast)
    shown, ground = contrast.shown(seen), empty and contrast.shown(empty)
    if ground is not None:
        check_place(shown.grey, ground, contrast.walls)
    if (walls := contrast.walls) is None or (stated is not None and runs_upright(seen.grey, by_hand.contrast)):
        return Detection(Status.UPRIGHT if runs_upright(seen.grey, by_hand.contrast) else Status.NO_WALLS)
    if (light := falling_light((ground or shown).grey, walls)) is not None:
        shown, ground = replace(shown, grey=shown.grey / light), ground and replace(ground, grey=ground.grey / light)
        walls = stated or find_walls((ground or shown).grey) or walls
    if stated is not None:
        walls = compared_with_bands(walls, (ground or shown).grey)
        if are_misplaced(walls):
            return Detection(Status.WALLS_OFF, walls.moved(columns.start, rows.start))
    level = estimate_background(shown.grey, walls) if ground is None else ground.grey
    faintest = CONTRAST if ground is None else FAINTEST
    near, erased = walls.rows_around(shown.shape), by_hand.erased_in_part(picture.shape)
    if erased is not None:
        erased = erased - np.array([0, near.start, 0, near.start])
    around = shown.cut((near, slice(None))), level[near], walls.moved(0, -near.start)
    found = _between(*around, direction, erased, by_hand.edge_offset, faintest)
    return completed(found.moved(columns.start, rows.start + near.start), picture.shape[1], camera)


def _between(
    picture: Picture,
    empty: Floats,
    walls: WallLines,
    direction: int,
    erased: Floats | None,
    edge_offset: Quantity | None,
    faintest: float,
) -> Detection:
    """Find a dark capsule in the rows of a picture around the walls."""
    between = walls.between(picture.shape)
    clipped = picture.grey[picture.clipped & between]
    if len(clipped) > CLIPPED * np.count_nonzero(between):
        return Detection(Status.BLACK if np.median(clipped) <= 0.0 else Status.SATURATED, walls)
    light = transmission(picture.grey, empty)
    noise = pixel_noise(light[between.any(axis=1)])
    blobs = find_blobs(light, walls, noise, erased, faintest)
    capsules = [blob for blob in blobs if blob.status is not Status.DEBRIS]
    if len(capsules) == 1:
        shift = edge_shift(light, walls, blobs)
        detection = analyse_blob(light, noise, walls, capsules[0], direction, shift, edge_offset)
    elif capsules:
        detection = Detection(Status.SEVERAL_CAPSULES, walls)
    else:  # bright between dark walls, as on the other side of focus, where a fringe hides the edge
        bright = any(blob.status.ok for blob in find_blobs(2.0 - light, walls, noise, erased))
        detection = Detection(Status.NO_EDGE if bright else Status.NO_CAPSULE, walls)
    if not detection.status.ok and any(is_shadow(blob, walls, light.shape[1]) for blob in blobs):
        return replace(detection, status=Status.SHADED)
    dead = np.flatnonzero((picture.clipped | ~between).all(axis=0))
    if len(dead):
        outer = np.empty(0) if detection.outline is None else np.percentile(detection.outline.points[:, 0], [0, 100])
        if np.nanmin(np.abs(np.append(detection.ends, outer)[:, None] - dead), initial=np.inf) < _NEAR:
            return replace(detection, status=Status.DEAD_COLUMN)
    return detection


@checked
def measure(
    picture: str | Path | ArrayLike,
    experiment: Experiment,
    *,
    capsule_velocity: Given | None = None,
    flow_rate: Given | None = None,
    background: str | Path | ArrayLike | None = None,
    flow: str | None = None,
    by_hand: ByHand | None = None,
) -> Measurement:
    """Measure the capsule in a picture.

    Parameters
    ----------
    picture : path or (rows, columns[, colours]) array
        A capsule in a channel along the rows, to 7 degrees.
    experiment : Experiment
    capsule_velocity : Quantity [m/s]
        v_o with its standard error, which one picture does not show; in any form that `Quantity.of`
        reads. It is missing where the flow rate is stated, or the experiment states the viscous tension.
    flow_rate : Quantity, optional [m^3/s]
        Flow rate in the channel with its standard error.
    background : path or array, optional
        The empty channel; by default it is estimated from the picture.
    flow : str, optional
        ``"right"`` or ``"left"``; by default it follows from the shape.
    by_hand : ByHand, optional
        What is stated of walls, scale, the part to analyse and what is wrong in it, as `capsbayes.image.ByHand`; by
        default they are found in the picture.

    Returns
    -------
    Measurement
        Lengths over l, measured against the walls of the same picture, and the silhouette with its noise. L_a is
        missing, with an upper bound, where the concave rear is not seen. Where nothing could be measured, the status
        gives the reason.

    Raises
    ------
    InputError
        If a file is missing or not a picture, `flow` is another word, or what is stated by hand does not suit the
        picture.
    """
    speed, rate = speeds_of("measure", capsule_velocity, flow_rate)
    if speed is None and rate is None and experiment.viscous_tension is None:
        Quantity.of(None, "capsule_velocity", where="measure")  # refuses that it is missing
    seen, detection = detected_in(picture, background, flow, by_hand, experiment)
    return measurement_of(detection, seen, experiment, speed, rate)


def detected_in(
    picture: Source, background: Source | None, flow: str | None, by_hand: ByHand | None, known: Experiment | None
) -> tuple[Picture, Detection]:
    """Return a picture, from a file or an array, as it is turned by hand, and what is detected in it."""
    empty = None if background is None else read_picture(background)
    seen, empty, by_hand = turned(read_picture(picture), empty, by_hand)
    width, camera = (None, None) if known is None else (known.half_width, known.camera)
    return seen, detect(seen, background=empty, flow=flow, by_hand=by_hand, half_width=width, camera=camera)


def speeds_of(where: str, velocity: Given | None, flow_rate: Given | None) -> tuple[Quantity | None, Quantity | None]:
    """Return the velocity of a capsule and the flow rate as quantities where they are given."""
    speed = None if velocity is None else Quantity.of(velocity, "capsule_velocity", where=where)
    return speed, None if flow_rate is None else Quantity.of(flow_rate, "flow_rate", where=where)


def turned(
    picture: Picture, background: Picture | None, by_hand: ByHand | None
) -> tuple[Picture, Picture | None, ByHand]:
    """Return picture and background made linear and turned as is stated by hand, and what else is stated."""
    by_hand = by_hand or ByHand()
    quarters, gamma = by_hand.quarters, by_hand.gamma
    background = background and background.linear(gamma).turned(quarters)
    return picture.linear(gamma).turned(quarters), background, replace(by_hand, rotate=None, gamma=None)


def measurement_of(
    detection: Detection,
    picture: Picture,
    experiment: Experiment,
    capsule_velocity: Quantity | None,
    flow_rate: Quantity | None = None,
) -> Measurement:
    """Return the measurement that follows from a detection in a picture, refused unless its status is ``DONE``."""
    status, width = detection.status, experiment.half_width.mean
    speeds = [] if capsule_velocity is None else [capsule_velocity.value]
    if flow_rate is not None:  # a capsule is not slower than the mean flow
        speeds.append(flow_rate.value / (AREAS[experiment.cross_section] * width**2))
    if status.ok and speeds and smeared(experiment.exposure, speeds[0], width / float(detection.lengths[3])):
        status = Status.SMEARED
    return measurement_of_lengths(
        detection.lengths,
        detection.covariance,
        capsule_velocity,
        experiment,
        flow_rate=flow_rate,
        outline=detection.silhouette,
        status=status,
        walls=detection.walls or "",
        source=picture.source,
        sha256=picture.sha256,
        gamma=picture.gamma,
        fringe=detection.fringe,
    )


_OF_ASKEW = np.array([2.0, 1.0])  # errors of L_z and L_a over the odd part: of an outline that is sheared, 2.1 and 0.3
_LEVEL = 0.004  # rad: up to it, errors of the edge look like a turn


# Something that sticks to an edge: of 7 px on drawn capsules it is beyond all three, and what is clean never is
_LEAST_BUMP, _OF_ERROR, _OF_USUAL = 0.008, 5.0, 5.0  # of l, of the errors of an outline, and of most of its odd part


def _juts_out(odd: Floats, error: float) -> bool:
    """Return whether an outline is far from its mirror image at one place alone, as it is where something sticks."""
    away = np.abs(uniform_filter1d(np.nan_to_num(odd), 3, mode="wrap")).max()
    usual = quantile(np.abs(odd[np.isfinite(odd)]), 0.75)
    return bool(away > max(_LEAST_BUMP, _OF_ERROR * error, _OF_USUAL * usual))


def _of_turn(points: Floats, turn: float) -> Floats:
    """Return how much less L_z and the distance of the nose are of an outline whose axis is turned back to the flow."""
    if abs(turn) < _LEVEL:
        return np.zeros(2)
    z, turned = points[:, 0], points @ [np.cos(turn), np.sin(turn)]
    return np.array([np.ptp(z) - np.ptp(turned), z.max() - turned.max()])


def asymmetry_of(outline: MeasuredOutline | None, half_width: float) -> tuple[Status, Floats]:
    """Return whether an outline is symmetric, and the covariance (2, 2) [px^2] of L_z and L_a due to its odd part."""
    if outline is None:
        return Status.DONE, np.zeros((2, 2))
    odd, turn = on_mirror(outline.points)
    askew = askew_size(outline.points, outline.noise, odd)
    status = Status.LOPSIDED if askew > MOST_ASKEW else Status.DONE
    errors = half_width * np.hypot(askew * _OF_ASKEW, _of_turn(outline.points, turn))
    # what a shear does to L_z tells nothing of L_a
    return Status.DOUBLET if _juts_out(odd, outline.noise.scale) else status, np.diag(errors**2)


def completed(detection: Detection, columns: int, camera: Camera | None) -> Detection:
    """Return a detection with its silhouette, without the faults of a camera; refused where it is not symmetric."""
    outline = silhouette_of(detection)
    if detection.status.ok and camera is not None:
        detection, outline = _straightened(detection, outline, columns, camera)
    status, further = asymmetry_of(outline, detection.lengths[3])
    if not status.ok:
        return Detection(status, detection.walls, detection.outline, detection.flow, blob=detection.blob)
    return replace(detection, further=detection.further + further, silhouette=outline)


def measurement_of_lengths(
    lengths: Floats,
    covariance: Floats,
    capsule_velocity: Quantity | None,
    experiment: Experiment,
    *,
    flow_rate: Quantity | None = None,
    outline: MeasuredOutline | None,
    status: Status = Status.DONE,
    walls: WallLines | str,
    source: str,
    sha256: str,
    gamma: float | None = None,
    fringe: float = 0.0,
) -> Measurement:
    """Return the measurement that follows from lengths in pixels, refused unless the status is ``DONE``."""
    file = Path(experiment.source) if experiment.source else None
    if not status.ok:
        return Measurement.refused(status, source=source, sha256=sha256, experiment_file=file)
    doubts = [] if isinstance(walls, str) else [walls.doubt]
    if gamma is not None:
        doubts.append(f"The grey levels are taken to be the light to the power of 1/{gamma:g}, as stated (--gamma).")
    if fringe > _FRINGE:
        seen = f"A fringe of the other sign, {100.0 * fringe:.0f} % as strong as the edge, surrounds the capsule."
        doubts.append(f"{seen} If it is out of focus, its edges may be off by more than their errors say.")
    scale, relative_error = 1.0 / lengths[3], np.sqrt(covariance[3, 3]) / lengths[3]
    known = [0, 1] if covariance[1, 1] < lengths[1] ** 2 < np.inf else [0]  # an error beyond its value tells nothing
    scaled = lengths[known] * scale
    spread = covariance[np.ix_(known, known)] * scale**2 + np.outer(scaled, scaled) * relative_error**2
    errors = np.sqrt(np.diag(spread))
    measured = Measurement(
        axial_extent=float(scaled[0]),
        axial_extent_error=float(errors[0]),
        capsule_velocity=None if capsule_velocity is None else capsule_velocity.value,
        capsule_velocity_error=np.nan if capsule_velocity is None else capsule_velocity.error,
        walls=walls if isinstance(walls, str) else walls.stated,
        doubt=" ".join(filter(None, doubts)),
        source=source,
        sha256=sha256,
        experiment_file=file,
        outline=outline,
    ).flowing(flow_rate)
    if len(known) == 1:
        return replace(measured, axial_length_bound=float(scaled[0] + 2.0 * errors[0]))
    return replace(
        measured,
        axial_length=float(scaled[1]),
        axial_length_error=float(errors[1]),
        length_correlation=float(spread[0, 1] / (errors[0] * errors[1])),
    )


def read_picture(source: Source) -> Picture:
    """Return a picture from a file or an array."""
    return Picture.read(source) if isinstance(source, (str, Path)) else Picture.from_array(source)


def check_flow(flow: str | None) -> int:
    """Return the sign of the flow, 0 if it is None; refuse another word than right or left."""
    if flow is not None and flow not in FLOWS:
        raise InputError("flow", "", " or ".join(f'"{name}"' for name in FLOWS), repr(flow))
    return 0 if flow is None else FLOWS[flow]


def write_detection(
    out: Path, picture: Picture, detection: Detection, measured: Measurement, known: Experiment
) -> None:
    """Write the overlay, the outline and the measurement; of a refused capsule, what was detected of it."""
    with together():
        write_overlay(out / "overlay.png", picture, detection, known.half_width.mean)
        if (outline := detection.outline) is not None:
            error = np.hypot(outline.point_error, outline.arc_error)
            columns = np.column_stack([outline.points, outline.normals, error, outline.edge_width])
            names = ("x_px", "y_px", "normal_x", "normal_y", "error_px", "edge_width_px")
            write_file(out / "outline.csv", text_of_numbers(names, columns, "%.4f"))
        if measured.status.ok:
            measured.write(out / "measurement.toml")
            rows = ["quantity,value,error"]
            for name, power, _, _, value, error in detection.table().loc["perimeter":].itertuples():
                unit = f"_over_l{power if power > 1 else ''}" if power else ""
                rows.append(f"{name}{unit},{value:.6g},{error:.2g}")
            write_file(out / "silhouette.csv", "\n".join(rows) + "\n")
