"""One capsule in a drawn picture: lengths, silhouette, camera, and what is wrong with a picture."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.linalg
from drawn import HALF_WIDTH, circle, drawn, shapes
from scipy.ndimage import shift

from capsbayes.errors import InputError
from capsbayes.experiment import Camera, Experiment
from capsbayes.image.by_hand import ByHand
from capsbayes.image.contour import ContourFile, measure_contour
from capsbayes.image.files import Picture
from capsbayes.image.film import measure_film
from capsbayes.image.measure import EdgeErrors, detect, measure, measurement_of_lengths, silhouette_of
from capsbayes.infer.outline import aligned_with
from capsbayes.measurement import askew_size
from capsbayes.quantity import Quantity
from capsbayes.status import Status
from evidence.synthetic import Optics, Scene, draw

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
BLURRED = Optics(blur=2.0, halo=0.05, electrons=5000)
UNEVEN = Optics(blur=1.0, motion=1.5, halo=0.08, vignetting=0.25, unevenness=0.1, electrons=5000)
PARACHUTE = drawn(0.08, 1.05, half_width=55.0)


def seen(made, *, flow=None, background=True):
    empty = Picture.from_array(made.background) if background else None
    return detect(Picture.from_array(made.picture), background=empty, flow=flow)


def measured(picture, background=None, *, experiment=EXPERIMENT, **how):
    return measure(picture, experiment, capsule_velocity=VELOCITY, background=background, **how)


# such a halo is as narrow as the edge, so that it may be light that was bent there: that of L_z is wider
NARROW_HALO = 0.65


@pytest.mark.parametrize(
    ("optics", "tolerance", "most"), [(Optics(), 0.2, 0.2), (UNEVEN, 0.35, NARROW_HALO), (BLURRED, 0.6, NARROW_HALO)]
)
@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("scene", [{}, {"tilt": 0.03, "flow": -1, "centre": (102.3, 97.1)}])
def test_lengths_of_a_parachute(optics, tolerance, most, background, scene):
    made = drawn(0.08, 1.05, optics=optics, half_width=55.0, **scene)
    detection = seen(made, background=background)
    assert detection.status is Status.DONE
    assert detection.flow == made.scene.flow
    truth = [made.axial_extent, made.axial_length, made.axial_extent - made.axial_length, made.half_width]
    np.testing.assert_allclose(detection.lengths, truth, atol=tolerance)
    errors = np.sqrt(np.diag(detection.covariance))
    assert np.all(errors > 0.01)
    assert errors[0] < most
    assert np.all(errors[1:] < tolerance)
    assert np.all(np.linalg.eigvalsh(detection.covariance) > -1e-12)


def test_the_outline_of_a_disc_lies_on_the_truth_and_does_not_tell_the_flow():
    made = draw(Scene(circle(0.8), circle(0.8), half_width=HALF_WIDTH), Optics(), seed=2)
    detection = seen(made)
    radius = np.hypot(*(detection.outline.points - made.scene.middle).T)
    assert radius.mean() == pytest.approx(0.8 * HALF_WIDTH, abs=0.05)
    assert radius.std() < 0.15
    assert detection.flow == 0
    assert detection.rear is None
    assert silhouette_of(detection) is None
    assert silhouette_of(seen(made, flow="right")) is not None


def test_a_convex_rear_gives_a_bound_not_a_length():
    made = drawn(0.03, 0.75)
    convex = measured(made.picture, made.background)
    assert convex.status is Status.DONE
    assert convex.axial_length is None
    assert made.axial_length / HALF_WIDTH < convex.axial_length_bound < 1.02 * convex.axial_extent
    assert convex.covariance.shape == (1, 1)


def test_a_rear_whose_error_exceeds_its_length_gives_a_bound_not_a_length():
    found = seen(PARACHUTE)
    wide = found.covariance.copy()
    wide[1, 1] = (1.1 * found.lengths[1]) ** 2
    known = {"outline": None, "walls": "", "source": "", "sha256": ""}
    clear, vague = (
        measurement_of_lengths(found.lengths, covariance, VELOCITY, EXPERIMENT, **known)
        for covariance in (found.covariance, wide)
    )
    assert clear.axial_length < clear.axial_extent == vague.axial_extent < vague.axial_length_bound
    assert vague.axial_length is None


def test_a_measurement_and_a_table_are_over_l_with_the_errors_of_both(tmp_path):
    for name in ("picture", "background"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), getattr(PARACHUTE, name))
    read = measured(tmp_path / "picture.png", tmp_path / "background.png")
    detection = seen(PARACHUTE)
    extent, length, _, half_width = detection.lengths
    assert read.over_half_width
    np.testing.assert_allclose(read.lengths, [extent / half_width, length / half_width])
    share = np.sqrt(np.diag(detection.covariance)) / detection.lengths
    relative = np.sqrt(share[:2] ** 2 + share[3] ** 2)
    np.testing.assert_allclose(np.sqrt(np.diag(read.covariance)) / read.lengths, relative)
    odd = np.array([2.0, 1.0]) * half_width * askew_size(read.outline.points, read.outline.noise)
    without = np.diag(replace(detection, further=np.zeros((2, 2))).covariance)
    np.testing.assert_allclose(np.diag(detection.covariance)[:2], without[:2] + odd**2)
    assert 0.0 < read.length_correlation < 1.0
    assert read.source.endswith("picture.png")
    assert len(read.sha256) == 64
    table, integrals = detection.table(), detection.integrals
    assert list(table.index) == ["L_z", "L_a", "L_p", "l", "perimeter", "area", "volume", "Lambda"]
    np.testing.assert_allclose(table["value_px"].iloc[:4], detection.lengths)
    assert table.loc["area", "value_over_l"] == pytest.approx(integrals.area.value / half_width**2)
    assert table.loc["l", ["value_over_l", "error_over_l"]].tolist() == [1.0, 0.0]
    assert table.loc["Lambda", "error_over_l"] == pytest.approx(integrals.stretch_ratio.error)


def test_the_difference_of_the_lengths_of_a_sheared_capsule_is_as_unsure_as_it_is_wrong():
    still, empty = measured(PARACHUTE.picture, PARACHUTE.background), np.maximum(PARACHUTE.background, 1.0)
    rows, columns = (np.arange(count) for count in empty.shape)
    late = 4.0 / seen(PARACHUTE).lengths[3] * (rows - rows.mean())  # rows that are read one after the other
    share = PARACHUTE.picture / empty
    moved = [np.interp(columns - way, columns, line) for way, line in zip(late, share, strict=True)]
    sheared = measured(np.rint(np.array(moved) * empty).clip(0, 255).astype(np.uint8), PARACHUTE.background)
    away, apart = sheared.lengths - still.lengths, np.array([1.0, -1.0])
    assert away[0] > 3.0 * abs(away[1])
    assert abs(away @ apart) < 1.96 * np.sqrt(apart @ sheared.covariance @ apart)


ALONE, SECOND = (drawn(0.1, 0.9, half_width=50.0, shape=(200, 300), centre=(x, 99.5)) for x in (90.0, 220.0))
FLAT = np.full_like(ALONE.picture, 150)


@pytest.mark.parametrize(
    ("picture", "background", "status"),
    [
        (ALONE.background, ALONE.background, Status.NO_CAPSULE),
        (FLAT, FLAT, Status.NO_WALLS),
        (ALONE.picture[:, 60:], ALONE.background[:, 60:], Status.TOUCHES_BORDER),
        (np.hstack([ALONE.picture[:, :155], SECOND.picture[:, 155:]]), ALONE.background, Status.SEVERAL_CAPSULES),
        (np.clip(3 * ALONE.picture.astype(int), 0, 255).astype(np.uint8), ALONE.background, Status.SATURATED),
        (ALONE.picture, ALONE.background[:, :-1], Status.BACKGROUND_DIFFERS),
    ],
)
def test_what_cannot_be_measured_ends_with_a_named_status(picture, background, status):
    refused = measured(picture, background)
    assert refused.status is status
    assert np.isnan(refused.axial_extent)
    assert np.all(np.isnan(refused.lengths))


def test_a_wrong_flow_is_refused():
    made = drawn(0.1, 0.9, flow=-1)
    assert seen(made, flow="right").status is Status.WRONG_FLOW
    assert seen(made, flow="left").status is Status.DONE
    with pytest.raises(InputError, match='expected "right" or "left"'):
        seen(made, flow="up")


@pytest.mark.parametrize(("exposure", "status"), [("0.1 ms", Status.DONE), ("1 ms", Status.SMEARED)])
def test_a_stated_exposure_in_which_the_capsule_moves_far_is_refused(exposure, status):
    """At 6 mm/s and 25 um to 60 px it moves by 1.4 px in 0.1 ms, by 14 px in 1 ms."""
    made = drawn(0.05, 0.8)
    exposed = measured(made.picture, made.background, experiment=replace(EXPERIMENT, exposure=exposure))
    assert exposed.status is status
    assert (exposed.outline is None) == (status is Status.SMEARED)


def silhouette(made):
    return silhouette_of(seen(made))


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_residuals_are_as_stated(blur):
    """Normal distances from the true silhouette, whitened: of variance one."""
    squares = []
    for seed, shape in enumerate([(0.03, 0.8), (0.05, 0.93), (0.08, 1.05), (0.1, 0.75)]):
        made = drawn(*shape, optics=Optics(blur=blur, electrons=5000), seed=seed)
        outline = silhouette(made)
        points, feet = aligned_with(outline.points, np.asarray(made.scene.silhouette))
        factor = scipy.linalg.cholesky(outline.noise.covariance(points) + outline.pose.offset**2, lower=True)
        squares.append(np.mean(scipy.linalg.solve_triangular(factor, feet.distance, lower=True) ** 2))
    assert 0.6 < np.mean(squares) < 1.3
    assert max(squares) < 1.8


def test_edges_next_to_a_wall_are_left_out():
    """A capsule that leaves 3 px to either wall, blurred by 2 px: its flanks would lie 0.3 px too far out."""
    made = drawn(0.005, 1.125, optics=Optics(blur=2.0, electrons=5000))
    detection, truth = seen(made), np.asarray(made.scene.silhouette)
    walls, clearance = detection.walls, detection.walls.clearance(detection.outline.points)
    assert clearance.min() < 4.0
    outline = silhouette_of(detection)
    y = outline.points[:, 1]
    assert np.abs(y - np.median(y)).max() < np.abs(truth[:, 1]).max() - 0.01
    every = (detection.outline.points - detection.axis) @ np.stack([walls.along, walls.across], 1)
    kept, located = (aligned_with(points, truth)[1].distance for points in (outline.points, every / HALF_WIDTH))
    assert located[clearance < 2.0 * walls.line_width].mean() * HALF_WIDTH > 0.2
    assert np.abs(kept).max() < 3.0 * np.hypot(outline.noise.scale, outline.pose.offset)


def test_a_capsule_that_moves_to_the_left_looks_the_same():
    right, left = (silhouette(drawn(0.08, 1.05, flow=flow)) for flow in (1, -1))
    assert right.view == "silhouette"
    for outline in (right, left):  # the blunt rear is behind: the centroid is nearer to it
        z = outline.points[:, 0]
        assert z.mean() < 0.5 * (z.max() + z.min())
    np.testing.assert_allclose(np.ptp(left.points, axis=0), np.ptp(right.points, axis=0), atol=0.005)


def test_blurred_and_noisy_edges_are_less_sure():
    sharp, blurred = (silhouette(drawn(0.08, 1.05, optics=Optics(blur=blur))) for blur in (0.6, 2.0))
    assert blurred.noise.scale > 1.2 * sharp.noise.scale
    assert blurred.noise.white < sharp.noise.white
    assert blurred.pose.offset > sharp.pose.offset
    optics = (Optics(electrons=electrons) for electrons in (50_000, 1500))
    found = [seen(drawn(0.08, 1.05, half_width=55.0, optics=each)) for each in optics]
    quiet, noisy = ((each.covariance - each.systematic_covariance)[0, 0] for each in found)
    assert np.sqrt(noisy) > 1.5 * np.sqrt(quiet)


def test_a_rear_whose_edge_is_a_band_has_an_error_of_its_own():
    sharp = seen(drawn(0.08, 1.05))
    outline = sharp.outline
    rear = sharp.flow * (outline.normals @ sharp.walls.along) < -0.7
    width = np.where(rear, np.hypot(outline.edge_width, 2.0), outline.edge_width)
    band = replace(sharp, outline=replace(outline, edge_width=width))
    assert EdgeErrors.of(sharp).rear == 0.0
    assert EdgeErrors.of(band).rear == pytest.approx(2.0, rel=0.1)
    assert silhouette_of(band).pose.rear == pytest.approx(2.0 / sharp.walls.half_width, rel=0.1)
    assert EdgeErrors.of(replace(band, flow=0)).rear == 0.0


FAULTS = {"pixel_aspect": 1.03, "distortion": -0.006, "taper": 0.01}


def photographed(picture, name, size):
    """Return the picture that a camera with a fault takes: where each of its pixels looks in the true picture."""
    rows, columns = picture.shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    middle = np.array([0.5 * (columns - 1), 0.5 * (rows - 1)])
    away = (np.stack([x, y], axis=-1) - middle) / HALF_WIDTH
    if name == "pixel_aspect":
        away = away / [size, 1.0]
    elif name == "distortion":  # seen at r (1 + size r^2); Newton's method for r
        seen = radius = np.hypot(away[..., 0], away[..., 1])
        for _ in range(20):
            radius = radius - (radius * (1.0 + size * radius**2) - seen) / (1.0 + 3.0 * size * radius**2)
        away = away * (radius / np.maximum(seen, 1e-9))[..., None]
    else:
        away = away / (1.0 + size * away[..., :1])
    source = (away * HALF_WIDTH + middle).astype(np.float32)
    return cv2.remap(picture, source[..., 0], source[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def walls_seen(name, size, columns):
    """Return what is stated of the walls, which are bent or open: their mean along the picture."""
    along = (np.arange(columns) - 0.5 * (columns - 1)) / HALF_WIDTH
    wider = {"pixel_aspect": 0.0 * along, "distortion": size * (1.0 + along**2), "taper": size * along}[name]
    half = HALF_WIDTH * (1.0 + wider.mean())
    return ByHand(walls=(99.5 - half, 99.5 + half))


@pytest.mark.parametrize("flow", [1, -1])
@pytest.mark.parametrize("name", FAULTS)
def test_a_stated_fault_is_taken_out(name, flow):
    size = FAULTS[name]
    made = drawn(0.08, 1.0, flow=flow, shape=(200, 320), centre=(180.0, 99.5), optics=Optics(electrons=20_000))
    pictures = [photographed(picture, name, size) for picture in (made.picture, made.background)]
    cameras = None, Camera(**{name: f"{size!r} +/- 0.002"})
    faulty, straight = (
        measured(*pictures, experiment=replace(EXPERIMENT, camera=camera), by_hand=walls_seen(name, size, 320))
        for camera in cameras
    )
    truth = np.array([made.axial_extent, made.axial_length]) / HALF_WIDTH
    np.testing.assert_allclose(straight.lengths, truth, atol=0.006)
    shape, pose = np.asarray(made.scene.silhouette), straight.outline.pose
    before, after = (aligned_with(each.outline.points, shape)[1].distance for each in (faulty, straight))
    assert np.abs(after).max() < 0.012
    assert after.std() < 0.6 * before.std()
    assert getattr(pose, name) == pytest.approx(0.002)
    assert pose.middle == pytest.approx(flow * (180.0 - 159.5) / HALF_WIDTH, abs=0.05)
    assert np.all(np.diag(straight.covariance) >= np.diag(faulty.covariance) * 0.9)


def test_an_uncertain_camera_makes_lengths_uncertain():
    made, camera = drawn(0.08, 1.0), Camera(pixel_aspect="1.00 +/- 0.01")
    plain, uncertain = (
        measured(made.picture, made.background, experiment=replace(EXPERIMENT, camera=each)) for each in (None, camera)
    )
    np.testing.assert_allclose(uncertain.lengths, plain.lengths, rtol=1e-12)
    added = 0.01 * plain.lengths
    np.testing.assert_allclose(uncertain.covariance - plain.covariance, np.outer(added, added), rtol=0.05)
    shown, empty = map(Picture.from_array, (made.picture, made.background))
    table = detect(shown, background=empty, camera=camera).table().loc[["L_z", "L_a"]]
    np.testing.assert_allclose(table["error_over_l"], np.sqrt(np.diag(uncertain.covariance)))


def test_a_contour_has_square_pixels_if_their_aspect_is_stated(tmp_path):
    profile = np.asarray(shapes()["profile"][40])
    path = tmp_path / "contour.csv"
    np.savetxt(path, 50.0 * profile * [1.03, 1.0] + 200.0, delimiter=",", header="x_px,y_px", comments="")
    options = {"capsule_velocity": VELOCITY, "flow": "right", "pixel_size": Quantity(0.5e-6, 2e-9, "m")}
    stated = replace(EXPERIMENT, camera=Camera(pixel_aspect="1.03 +/- 0.004"))
    square, faulty = (measure_contour(ContourFile.read(path), known, **options) for known in (stated, EXPERIMENT))
    assert square.axial_extent == pytest.approx(np.ptp(profile[:, 0]), rel=1e-4)
    assert faulty.axial_extent == pytest.approx(1.03 * square.axial_extent)
    assert square.outline.pose.pixel_aspect == pytest.approx(0.004)
    assert square.axial_extent_error > np.hypot(0.9 * faulty.axial_extent_error / 1.03, 0.003 * square.axial_extent)
    bent = replace(EXPERIMENT, camera=Camera(distortion=-0.01))
    with pytest.raises(InputError, match="camera: expected pixel_aspect alone for a contour"):
        measure_contour(ContourFile.read(path), bent, **options)


MADE = drawn(0.03, 0.8, seed=4, shape=(160, 260), optics=Optics(electrons=8000))
SEEN, EMPTY = MADE.picture.astype(float), MADE.background.astype(float)
ROWS, COLUMNS = SEEN.shape
Y, X = np.mgrid[:ROWS, :COLUMNS].astype(float)
AROUND = ((X - 129.5) / 130.0) ** 2 + ((Y - 79.5) / 80.0) ** 2
with_and_without_background = pytest.mark.parametrize("background", [MADE.background, None], ids=["given", "guessed"])


def counts(grey):
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def moved(grey, rows):
    return shift(grey, (rows, 0), order=1, mode="nearest")


def check(picture, background=None):
    """The lengths over l hold the truth within three standard errors."""
    right = measured(picture, background)
    assert right.status is Status.DONE
    assert abs(right.axial_extent - MADE.axial_extent / MADE.half_width) < 3.0 * right.axial_extent_error


TURN = cv2.getRotationMatrix2D((129.5, 79.5), 1.0, 1.0)
TURNED = cv2.warpAffine(EMPTY, TURN, (COLUMNS, ROWS), borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(
    ("picture", "background", "message"),
    [
        (SEEN, counts(0.7 * EMPTY), r"darker: its median is 0\.7 of the picture's; take both with the same exposure"),
        (0.5 * SEEN, EMPTY, "brighter: its median is 2 of the picture's"),
        (np.rint(16 * SEEN).astype(np.uint16), MADE.background, r"darker: .* \(8 bits, and the picture 12\)"),
        (MADE.picture, np.rint(16 * EMPTY).astype(np.uint16), r"brighter: .* \(12 bits, and the picture 8\)"),
        (SEEN, moved(EMPTY, 3), r"lies 3\.0 px lower than it"),
        (SEEN, moved(EMPTY, -5), r"lies 5\.0 px higher than it"),
        (SEEN, TURNED, r"is turned by 1\.0 degrees"),
        (SEEN, np.roll(SEEN, 20, axis=1), "the empty channel, got one with something dark at column 1"),
        (SEEN, SEEN, "the empty channel, got one with something dark at column 12"),
    ],
)
def test_a_background_that_does_not_fit_is_named(picture, background, message):
    with pytest.raises(InputError, match=f"background: expected .*{message}.*, or leave the background out"):
        measured(picture, background)


@pytest.mark.parametrize("background", [0.85 * EMPTY, 1.15 * EMPTY, moved(EMPTY, 1), EMPTY[:, ::-1], EMPTY[::-1]])
def test_a_background_that_is_hardly_off_does_no_harm(background):
    check(MADE.picture, counts(background))


def test_what_is_no_picture_of_grey_levels_is_named():
    levels = r"expected grey levels of a camera, got (two|4) levels, as behind a thresh"
    for picture, message in (
        (SEEN > 120.0, levels),
        (255 * (SEEN > 120.0).astype(np.uint8), levels),
        (64 * (MADE.picture // 64), levels),
        *(
            (SEEN.astype(kind), "expected real numbers as grey levels, got values of")
            for kind in (complex, str, object)
        ),
        ((SEEN - 150.0).astype(np.int16), r"got \d+% of them below zero, as after a subtraction; give the"),
    ):
        with pytest.raises(InputError, match=message):
            measured(picture)
    check((SEEN - 30.0).astype(np.int16))
    assert measured(counts(SEEN - 130.0), by_hand=ByHand(walls=(19.5, 139.5), contrast="dark")).status is Status.BLACK


@pytest.mark.parametrize("loss", [0.3, 0.5, 0.6])
@with_and_without_background
def test_vignetting_is_measured_right(loss, background):
    light = 1.0 - 0.5 * loss * AROUND
    check(counts(SEEN * light), None if background is None else counts(EMPTY * light))
    check(counts(SEEN * (1.0 - loss * X / COLUMNS)))


@pytest.mark.parametrize("deep", [0.3, 0.5])
@pytest.mark.parametrize("wide", [4, 8, 15])
def test_a_shadow_on_a_wall_is_measured_right_or_named(deep, wide):
    inwards = Y - (79.5 - MADE.half_width)
    shade = 1.0 - deep * np.exp(-np.maximum(0.0, inwards - wide) / 2.0) * (inwards > 0.0)
    check(counts(SEEN * shade))
    half = np.where(X < COLUMNS / 2, 1.0, shade)
    assert measured(counts(SEEN * half), MADE.background).status is Status.SHADED


@pytest.mark.parametrize("level", [0, 40, 255])
@with_and_without_background
def test_a_dead_row_or_column_is_filled_or_named(level, background):
    for place in (np.s_[5], np.s_[27], np.s_[79], np.s_[:, 8], np.s_[:, 129]):
        picture, empty = MADE.picture.copy(), MADE.background.copy()
        picture[place] = empty[place] = level
        check(picture, None if background is None else empty)
    picture[:, round(MADE.outline[:, 0].max())] = level
    assert measured(picture, background).status is Status.DEAD_COLUMN


@pytest.mark.parametrize("place", [np.s_[50, :130], np.s_[79:81, 130:], np.s_[60, 100:]])
def test_half_a_dead_row_is_named(place):
    """It joins the capsule to the border."""
    picture = MADE.picture.copy()
    picture[place] = 0
    assert measured(picture).status is measured(picture, MADE.background).status is Status.SHADED
    assert measured(MADE.picture[:, 100:]).status is Status.TOUCHES_BORDER


def test_the_walls_of_two_channels_are_no_channel_and_hot_pixels_do_no_harm():
    stacked = np.vstack([MADE.picture, MADE.picture])
    assert measured(stacked).status is Status.NO_WALLS
    assert "or several channels; cut it around one" in str(Status.NO_WALLS)
    cut = measured(stacked, by_hand=ByHand(crop=(0, 0, COLUMNS, ROWS)))
    np.testing.assert_allclose(cut.lengths, measured(MADE.picture).lengths)
    picture, random = MADE.picture.copy(), np.random.default_rng(1)
    picture[random.integers(0, ROWS, 40), random.integers(0, COLUMNS, 40)] = 255
    check(picture, MADE.background)


@with_and_without_background
def test_a_channel_that_runs_up_and_down_is_named_and_turned_when_asked(background):
    upright, empty = np.rot90(MADE.picture), background if background is None else np.rot90(background)
    assert measured(upright, empty).status is Status.UPRIGHT
    turned = measured(upright, empty, by_hand=ByHand(rotate="90"))
    np.testing.assert_allclose(turned.lengths, measured(MADE.picture, background).lengths)


@pytest.mark.parametrize("axis", [0, 1, (0, 1)], ids=["across the flow", "along the flow", "upside down"])
def test_a_mirrored_picture_is_measured_as_it_is(axis):
    """To 0.01 px, a tenth of the error; to half of the error in noise, as samples of the edge begin elsewhere."""
    clean = drawn(0.08, 1.05, half_width=55.0, optics=Optics(electrons=1e9))
    plain, mirrored = (detect(Picture.from_array(seen)) for seen in (clean.picture, np.flip(clean.picture, axis)))
    assert (plain.flow, mirrored.flow) == (1, 1 if axis == 0 else -1)
    np.testing.assert_allclose(mirrored.lengths, plain.lengths, rtol=0.0, atol=0.01)


def test_a_turned_channel_whose_pixels_are_stated_and_a_turned_film(tmp_path):
    upright, size = Picture.from_array(np.rot90(MADE.picture)), "0.4167 +/- 0.004 um"
    placed = detect(upright, by_hand=ByHand(rotate=90, pixel_size=size, axis=79.5), half_width="25 +/- 0.2 um")
    assert placed.lengths[0] == pytest.approx(MADE.axial_extent, abs=0.4)
    assert detect(upright, by_hand=ByHand(pixel_size=size), half_width="25 um").status is Status.UPRIGHT
    with pytest.raises(InputError, match="rotate: expected 90, 180, 270 degrees clockwise, got '45'"):
        ByHand(rotate="45")
    for number in range(12):
        at = (60.0 + 10.0 * number, 44.5)
        frame = drawn(0.03, 0.8, half_width=30.0, seed=number, shape=(90, 240), centre=at).picture
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.rot90(frame))
    assert measure_film(tmp_path, EXPERIMENT, frame_rate="400 Hz").status is Status.UPRIGHT
    film = measure_film(tmp_path, EXPERIMENT, frame_rate="400 Hz", by_hand=ByHand(rotate=90))
    assert film.capsules[0].status is Status.DONE
