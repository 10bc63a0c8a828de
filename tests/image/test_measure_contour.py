import json
import struct

import cv2
import numpy as np
import pytest
from drawn import circle, shapes

from capsbayes import Surrogate, identify
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.contour import ContourFile, measure_contour
from capsbayes.profile import Profile
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
PIXEL = Quantity(0.5e-6, 0.002e-6, "m")


def measured(path, unit=None, **options):
    given = {"edge_error": Quantity(0.05e-6, 0.0, "m"), "flow": "right", "pixel_size": PIXEL} | options
    speed = Quantity(6e-3, 6e-5, "m/s")
    return measure_contour(ContourFile.read(path, unit), EXPERIMENT, capsule_velocity=speed, **given)


def written(path, points, header="x_px,y_px"):
    np.savetxt(path, points, fmt="%.6g", delimiter=",", header=header, comments="")
    return path


def parachute():
    cases = shapes()
    profile = cases["profile"][int(np.argmax(cases["axial_extent"] - cases["axial_length"]))]
    outline = Profile.from_outline(profile)
    return profile, outline.axial_extent, outline.axial_length


@pytest.mark.parametrize(("header", "scale"), [("x_px,y_px", 50.0), ("x_um,y_um", 25.0), ("y_um,label,x_um", 25.0)])
@pytest.mark.parametrize("flow", ["right", "left"])
def test_a_traced_parachute_has_both_lengths(tmp_path, header, scale, flow):
    profile, extent, length = parachute()
    points = scale * np.asarray(profile) * [1.0 if flow == "right" else -1.0, 1.0] + [200.3, 80.7]
    if "label" in header:
        points = np.column_stack([points[:, 1], np.zeros(len(points)), points[:, 0]])
    found = measured(written(tmp_path / "c.csv", points, header), flow=flow)
    assert found.over_half_width
    np.testing.assert_allclose(found.lengths, [extent, length], atol=1e-4)
    pixel = 0.0 if "um" in header else 0.002 / 0.5 * extent
    # half of the variance is alike at both ends
    assert found.axial_extent_error == pytest.approx(np.hypot(np.sqrt(3.0) * 0.05e-6 / 25e-6, pixel), rel=1e-2)
    z, y = found.outline.points.T
    on_axis = z[np.abs(y) < 0.2]  # the nose alone: the rear that is seen through the rim is no part of the silhouette
    assert len(on_axis) > 2
    assert np.all(on_axis > z.mean())


def test_the_text_file_of_imagej_needs_its_unit(tmp_path):
    np.savetxt(tmp_path / "points.txt", 20.0 * circle(1.0), delimiter="\t", fmt="%.3f")
    assert measured(tmp_path / "points.txt", "um").axial_extent == pytest.approx(1.6, rel=2e-3)
    with pytest.raises(InputError, match="or the unit px or um"):
        measured(tmp_path / "points.txt")


def test_a_polygon_through_pixel_centres_is_not_taken_for_the_edge(tmp_path):
    """It understates the radius by some 0.45 px; without being told, a contour of whole pixels is refused."""
    errors = []
    for radius in 18.3 + 1.03 * np.arange(12):
        yy, xx = np.mgrid[:80, :80]
        mask = (np.hypot(xx - 39.7, yy - 40.2) < radius).astype(np.uint8)
        contour = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0][:, 0]
        path = written(tmp_path / "mask.csv", contour)
        found = measured(path, points="centres", edge_error=Quantity(0.2e-6, 0.0, "m"))
        errors.append(50.0 * found.axial_extent - 2.0 * radius)
        assert abs(errors[-1]) < 2.5 * 50.0 * found.axial_extent_error
        assert found.axial_length is None
        assert found.axial_length_bound > found.axial_extent
    assert abs(np.mean(errors)) < 0.3
    with pytest.raises(InputError, match="say centres or borders"):
        measured(path)


def clicked(radius=30.0, count=30, scatter=0.0, seed=0):
    """Points that a hand set on a circle, at unequal distances."""
    random = np.random.default_rng(seed)
    angle = 2.0 * np.pi * (np.arange(count) + 0.3 * random.uniform(-1.0, 1.0, count)) / count
    points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + scatter * random.standard_normal((count, 2))
    return points + np.array([80.25, 60.5])


def roi(points, *, kind=0, whole=False):
    """The bytes of an ImageJ ROI."""
    x, y = np.rint(points).astype(int).T
    left, top, count = x.min(), y.min(), len(points)
    head = struct.pack(">4shBxhhhhH", b"Iout", 228, kind, top, left, y.max(), x.max(), count).ljust(64, b"\0")
    if not whole:
        head = head[:50] + struct.pack(">h", 128) + head[52:]
    body = np.concatenate([x - left, y - top]).astype(">i2").tobytes()
    return head + body + (b"" if whole else points.T.astype(">f4").tobytes())


def labelme(points, *more):
    shapes = [{"label": "capsule", "shape_type": "polygon", "points": points.tolist()}, *more]
    return json.dumps({"shapes": shapes, "imageWidth": 160}).encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("c.roi", roi(clicked())),
        ("c.roi", roi(clicked(), kind=7, whole=True)),
        ("c.json", labelme(clicked())),
        ("c.json", labelme(clicked(), {"label": "wall", "shape_type": "line", "points": [[0, 0], [1, 1]]})),
    ],
)
def test_a_contour_drawn_by_hand_has_a_silhouette(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    found = measured(tmp_path / name, edge_error=None)
    assert found.axial_extent == pytest.approx(60.0 / 50.0, abs=0.02)
    assert found.axial_extent_error == pytest.approx(np.sqrt(3.0) / 50.0, rel=0.3)
    assert found.outline.view == "silhouette"
    radius = np.hypot(*(found.outline.points - found.outline.points.mean(axis=0)).T)
    np.testing.assert_allclose(radius, 0.6, atol=0.03)
    # the error of one pixel: half of its variance is alike all around, half drifts along the edge
    assert found.outline.pose.offset == pytest.approx(np.sqrt(0.5) / 50.0, rel=0.1)
    assert found.outline.noise.scale == pytest.approx(np.sqrt(0.5) / 50.0, rel=0.4)


def test_the_scatter_of_clicks_is_that_of_their_points(tmp_path):
    """The error of the edge, which the points do not show, stays; what they show is added."""
    for scatter in (0.3, 1.0):
        whites = []
        for seed in range(12):
            path = tmp_path / "c.json"
            path.write_bytes(labelme(clicked(scatter=scatter, count=40, seed=seed)))
            noise = measured(path, edge_error=Quantity(0.25e-6, 0.0, "m")).outline.noise
            whites.append(noise.scale * np.sqrt(noise.white) * 50.0)
        assert np.mean(whites) == pytest.approx(scatter, rel=0.25)


def test_a_silhouette_drawn_by_hand_tells_the_capsule(tmp_path):
    """Clicks of 0.5 px on the silhouette of a capsule of the database, drawn half a pixel too far out."""
    cases = shapes()
    row = int(np.argmin(np.abs(np.log(cases["capillary_number"] / 0.06)) + np.abs(cases["size_ratio"] - 0.9)))
    random = np.random.default_rng(4)
    silhouette = np.asarray(cases["silhouette"][row])[::6]
    points = 60.0 * silhouette * (1.0 + 0.5 / 60.0) + 0.5 * random.standard_normal(silhouette.shape) + 100.0
    (tmp_path / "c.json").write_bytes(labelme(points))
    experiment = Experiment(cross_section="square", half_width=30e-6, viscosity=1.0)
    found = measure_contour(
        ContourFile.read(tmp_path / "c.json"),
        experiment,
        capsule_velocity=Quantity(5e-3, 5e-5, "m/s"),
        flow="right",
        pixel_size=PIXEL,
    )
    assert found.axial_length is None  # a silhouette that is hollow by some errors shows no concave rear
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    posterior = identify(found, model, experiment, seed=1, engine="quadrature")
    assert posterior.status.ok
    for name in ("capillary_number", "size_ratio"):
        marginal = posterior.marginals[name]
        assert marginal.lower_95 < cases[name][row] < marginal.upper_95
    assert posterior.marginals["size_ratio"].upper_95 < 1.15 * posterior.marginals["size_ratio"].lower_95


def test_walls_give_the_scale_of_a_contour_in_pixels(tmp_path):
    """l is half the distance of the walls: the error of the half width in metres is none of the lengths over l."""
    profile, extent, length = parachute()
    path = written(tmp_path / "c.csv", 50.0 * np.asarray(profile) + [200.3, 80.7])
    by_size = measured(path)
    found = measured(path, pixel_size=None, walls="30.7, 130.7", wall_error="0.2 px")
    np.testing.assert_allclose(found.lengths, [extent, length], atol=1e-4)
    own = by_size.axial_extent_error**2 - (0.002 / 0.5 * extent) ** 2
    assert found.axial_extent_error == pytest.approx(np.sqrt(own + (0.2 / np.sqrt(2.0) / 50.0 * extent) ** 2), rel=1e-3)
    assert found.walls == "walls by hand at rows 30.7, 130.7 px, each +/- 0.2 px"
    assert found.outline.pose.offset > 0.0


def turned(*parts):
    """Points on a circle of radius 40 px about (100, 80) at turns from and to, with a number of points each."""
    turn = np.concatenate([np.linspace(start, end, count, endpoint=False) for start, end, count in parts])
    return 40.0 * np.stack([np.cos(2.0 * np.pi * turn), np.sin(2.0 * np.pi * turn)], axis=1) + [100.3, 80.2]


def eight(shift):
    """A figure of eight, which crosses itself at two vertices, or between them."""
    angle = 2.0 * np.pi * (np.arange(40) + shift) / 40
    return np.stack([100.3 + 40.0 * np.sin(angle), 80.2 + 30.0 * np.sin(2.0 * angle)], axis=1)


WHOLE = turned((0.0, 1.0, 64))


def inner(step):
    """Every so many points of the circle, on a smaller one."""
    return 0.4 * WHOLE[::step] + 0.6 * WHOLE.mean(axis=0)


def spiked(count, share, width=1):
    """A circle of which some points next to each other lie a share of the radius further out."""
    points = turned((0.0, 1.0, count))
    points[:width] += share * (points[:width] - points.mean(axis=0))
    return points


@pytest.mark.parametrize("share", [0.1, -0.1])
@pytest.mark.parametrize("count", [50, 64, 350])
@pytest.mark.parametrize("width", [1, 2])
def test_a_point_off_the_edge_is_refused(tmp_path, count, share, width):
    with pytest.raises(InputError, match=r"points along the edge of the capsule, got one that juts out by .* px at \("):
        measured(written(tmp_path / "c.csv", spiked(count, share, width)))


def test_a_point_a_little_off_the_edge_is_in_its_error(tmp_path):
    found = measured(written(tmp_path / "c.csv", spiked(100, 0.03)))
    whole = measured(written(tmp_path / "d.csv", turned((0.0, 1.0, 100))))
    assert abs(found.axial_extent - whole.axial_extent) < found.axial_extent_error
    assert found.axial_extent_error > 2.0 * whole.axial_extent_error


@pytest.mark.parametrize(
    "points",
    [
        WHOLE[::-1],
        np.concatenate([WHOLE, WHOLE[:1]]),
        np.repeat(WHOLE, 2, axis=0),
        turned((0.0, 0.2, 20), (0.2, 0.5, 10), (0.5, 1.0, 30)),  # points set more closely where the curve matters
    ],
)
def test_the_same_contour_in_other_points_is_the_same(tmp_path, points):
    assert measured(written(tmp_path / "c.csv", points)).axial_extent == pytest.approx(1.6, abs=1e-3)


@pytest.mark.parametrize("count", [40, 300])
def test_what_is_missing_of_a_contour_is_in_its_error(tmp_path, count):
    """The nose, over a sixteenth of a circle: the chord is 0.8 px inside."""
    found = measured(written(tmp_path / "c.csv", turned((1.0 / 32.0, 31.0 / 32.0, count))))
    whole = measured(written(tmp_path / "d.csv", turned((0.0, 1.0, count))))
    assert abs(found.axial_extent - 1.6) < 1.5 * found.axial_extent_error
    assert found.axial_extent_error > (3.0 if count == 300 else 0.99) * whole.axial_extent_error


def test_runs_of_pixels_do_not_bulge(tmp_path):
    """OpenCV writes the ends of each run alone; a cubic through them made this circle 0.1 l too long."""
    mask = np.zeros((160, 160), np.uint8)
    yy, xx = np.mgrid[:160, :160]
    mask[np.hypot(xx - 79.7, yy - 80.2) < 60.0] = 1
    ends = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0][0][:, 0]
    assert measured(written(tmp_path / "c.csv", ends), points="centres").axial_extent == pytest.approx(2.4, abs=0.02)


@pytest.mark.parametrize(
    ("form", "separator", "decimal", "heading"),
    [("utf-8-sig", ";", ",", "x_px;y_px"), ("utf-16", "\t", ",", "x_px\ty_px"), ("latin-1", "\t", ".", "X\tY"),
     ("utf-8", " ", ".", ""), ("utf-8", ";", ",", "")],
)  # fmt: skip
def test_points_of_other_programs(tmp_path, form, separator, decimal, heading):
    lines = [separator.join(f"{value:.2f}".replace(".", decimal) for value in point) for point in WHOLE]
    (tmp_path / "c.csv").write_bytes("\r\n".join([heading, *lines][not heading :]).encode(form))
    found = ContourFile.read(tmp_path / "c.csv", "px")
    np.testing.assert_allclose(found.points, WHOLE, atol=0.006)


CSV, PX, UM = "c.csv", "x_px,y_px", "x_um,y_um"
DISC, WALLED = 20.0 * circle(1.0), 40.0 * circle(1.0) + [200.3, 80.7]


@pytest.mark.parametrize(
    ("name", "content", "given", "message"),
    [
        (CSV, "", {}, "no names of columns"),
        (CSV, "length,width\n1,2\n", {}, "columns: expected x_px, y_px or x_um, y_um, got length, width"),
        (CSV, UM + "\n1,2\n3,4\n", {}, "points: expected at least 16 points, got 2"),
        (CSV, UM + "\n1,2\n3,\n", {}, "line 3: expected numbers for x_um and y_um, got 3, nan"),
        (CSV, PX + "\n168,01,79,71\n", {}, "2 cells, got 4, separated by ','; write decimal points"),
        (CSV, PX + "\n1,2\nNaN,79.71\n", {}, "line 3: expected numbers for x_px and y_px, got nan, 79.71"),
        (CSV, PX + "\n1,2\n\n3,4\n", {}, "line 4: expected numbers for x_px and y_px, got 3, 4, below a blank row"),
        (CSV, "x_px;y_px\n1,5;2\n1.5;2\n", {}, "a comma or a point, got '1,5' in line 2 and '1.5' in line 3"),
        (CSV, PX + "\n1,2\n", {"unit": "mm"}, "unit: expected px, which its columns state, got 'mm'"),
        (CSV, PX + "\n1,2\n", {"unit": "um"}, "unit: expected px, which its columns state, got 'um'"),
        (CSV, "x,y\n1,2\n", {}, "or the unit px or um, got none of them"),
        (CSV, (PX, DISC), {"pixel_size": None}, "pixel size: expected one with an error"),
        (CSV, (UM, DISC), {"edge_error": None}, "edge error: expected that of a contour in um"),
        (CSV, (PX, WALLED), {"walls": "60, 130.7"}, "one wall on either side of the contour, whose rows are"),
        (CSV, (PX, WALLED), {"walls": "30 31, 130 131"}, "two rows: a contour does not tell the borders"),
        (CSV, (UM, WALLED), {"walls": "30.7, 130.7"}, "a contour in pixels, as the walls are, got"),
        (CSV, (PX, WALLED), {"walls": "30.7"}, "walls: expected the rows of two walls in px"),
        (CSV, (PX, eight(0.0)), {}, "crosses itself"),
        (CSV, (PX, eight(0.5)), {}, "crosses itself"),
        (CSV, (PX, np.random.default_rng(1).permutation(WHOLE)), {}, "points that are not in order"),
        (CSV, (PX, np.concatenate([WHOLE, WHOLE])), {}, "a second loop"),
        (CSV, (PX, np.concatenate([WHOLE, inner(-2)])), {}, "a second loop"),
        (CSV, (PX, np.concatenate([WHOLE, inner(2)])), {}, "crosses itself"),
        (CSV, (PX, turned((0.0, 0.75, 48))), {}, "around the capsule, once, got none between (96.38, 40.39) and ("),
        (CSV, (PX, turned((0.125, 1.0, 350))), {}, "points all around the capsule, once, got none between"),
        ("c.roi", b"", {}, "expected an ImageJ ROI"),
        ("c.roi", b"PK" * 60, {}, "got another file"),
        ("c.roi", roi(clicked(), kind=1), {}, "got a ROI of type 1"),
        ("c.roi", roi(clicked())[:120], {}, "expected an ImageJ ROI"),
        ("c.json", b'{"shapes": [{"points": [[1' + b"0" * 400 + b", 2]]}]}", {}, "a LabelMe file with a polygon"),
        ("c.json", b"{", {}, "a LabelMe file with a polygon"),
        ("c.json", b'{"shapes": [{"points": [[1]]}]}', {}, "a LabelMe file with a polygon"),
        ("c.json", b'{"shapes": []}', {}, "expected one polygon, the contour, got none"),
        ("c.json", labelme(clicked(), {"label": "cell 2", "points": []}), {}, "got capsule, cell 2"),
        ("c.json", labelme(clicked(count=8)), {}, "at least 16 points, got 8"),
        ("c.json", labelme(clicked() * np.nan), {}, "point 1: expected finite coordinates, got nan, nan"),
        ("c.json", labelme(clicked()), {"unit": "um"}, "unit: expected px, in which a .json file is"),
    ],
)
def test_what_is_no_contour_or_lacks_what_it_needs_is_refused_in_one_line(tmp_path, name, content, given, message):
    path = tmp_path / name
    if isinstance(content, tuple):
        written(path, content[1], content[0])
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        measured(path, **({"pixel_size": None} if "walls" in given else {}) | given)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
