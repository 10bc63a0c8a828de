"""What is wrong with a capsule or its picture is refused, or is in the errors of the lengths."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from command_line import run
from scipy.ndimage import gaussian_filter1d

from capsbayes import Database, Experiment, Measurement, Surrogate, identify
from capsbayes.image import ByHand, Picture, detect, measure
from capsbayes.image.walls import find_walls
from capsbayes.status import Status
from evidence.benchmarks import camera as renderer
from evidence.benchmarks import microscope
from evidence.benchmarks.camera import Camera, photograph
from evidence.benchmarks.conditions import HALF_WIDTH, overlapping, scenery, taken
from evidence.benchmarks.picture_moduli import bumped, salted
from evidence.benchmarks.stored import POOL_FOLDER
from evidence.exam.sessions import read_pool

EXPERIMENT = Experiment(cross_section="square", half_width="25.0 +/- 0.001 um", viscosity=0.85)
CAPSULES = range(400, 408)


@pytest.fixture(scope="module")
def scenes():
    """Views of capsules, their pictures and those of the empty channel."""
    cases = Database.open("square-neo-hookean").converged
    views = [scenery(cases, np.random.default_rng([2026, number])) for number in CAPSULES]
    return [(view, *photograph(view, camera, seed=n)) for n, (view, camera) in enumerate(views)]


def spotted(picture, place, radius):
    made = picture.copy()
    cv2.circle(made, tuple(round(float(each)) for each in place), radius, 60, -1, cv2.LINE_AA)
    return made


def specked(picture, place):
    """A dark speck of 3 px, as sharp as the capsule."""
    speck = np.zeros(picture.shape, np.uint8)
    cv2.circle(speck, np.rint(16.0 * place).astype(int).tolist(), 24, 255, -1, cv2.LINE_AA, shift=4)
    share = cv2.GaussianBlur(speck / 255.0, (0, 0), 0.7)
    return np.rint(picture + share * (np.minimum(picture, 60.0) - picture)).astype(np.uint8)


def sheared(picture, empty, way):
    """As a camera takes it that reads row after row: so many px later at each l further down."""
    rows, columns = np.arange(picture.shape[0]), np.arange(picture.shape[1])
    late, light = way * (rows - rows.mean()) / HALF_WIDTH, picture / empty
    seen = np.array([np.interp(columns - late[row], columns, light[row]) for row in rows])
    return np.clip(seen * empty, 0, 255).astype(np.uint8)


def turned(picture, empty, view, degrees):
    """The capsule alone is turned, in a channel that is not."""
    turn = cv2.getRotationMatrix2D(view.capsules[0].centre, degrees, 1.0)
    light = cv2.warpAffine(picture / empty, turn, picture.shape[::-1], flags=cv2.INTER_CUBIC, borderValue=1.0)
    return np.clip(light * empty, 0, 255).astype(np.uint8)


def edge_of(view):
    return view.placed(view.capsules[0].silhouette, view.capsules[0])


def end_of(view, side):
    points = edge_of(view)
    return points[np.argmax(side * points @ view.along)]


def off(scenes, spoiled):
    """Errors of L_z over the stated ones, and the statuses of what is refused."""
    scores, statuses = [], []
    for view, picture, empty in scenes:
        found = measure(spoiled(view, picture, empty), EXPERIMENT, capsule_velocity="6 +/- 0.1 mm/s", background=empty)
        if found.status.ok:
            scores.append((found.axial_extent - view.axial_extent / HALF_WIDTH) / found.axial_extent_error)
        else:
            statuses.append(found.status)
    return np.array(scores), statuses


def test_a_capsule_without_fault_is_measured(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: picture)
    assert not statuses
    assert np.count_nonzero(np.abs(scores) > 1.96) <= 1


def test_dirt_on_the_nose_is_refused(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: spotted(picture, end_of(view, 1.0), 3))
    assert len(scores) == 0
    assert set(statuses) == {Status.DOUBLET}


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["nose", "rear"])
def test_a_speck_on_either_end_is_refused(scenes, side):
    """It makes L_z too long by 1 px, three of its errors."""
    scores, statuses = off(scenes, lambda view, picture, empty: specked(picture, end_of(view, side)))
    assert len(scores) == 0
    assert set(statuses) == {Status.DOUBLET}


@pytest.mark.parametrize("end", [1, -1])
def test_a_body_whose_rim_is_too_faint_is_not_taken_for_two(scenes, end):
    """Of a body without a membrane the rim of a concave rear absorbs hardly any light."""
    _, _, empty = scenes[0]
    rows, columns = empty.shape
    circle, middle = np.zeros(empty.shape, np.uint8), (columns // 2, rows // 2)
    cv2.circle(circle, middle, 45, 255, -1, cv2.LINE_AA)
    cv2.ellipse(circle, (middle[0] + 45 * end, middle[1]), (25, 36), 0.0, 0.0, 360.0, 0, -1, cv2.LINE_AA)
    light = 1.0 - 0.3 * cv2.GaussianBlur(circle / 255.0, (0, 0), 0.8)
    assert detect(Picture.from_array(empty * light), background=Picture.from_array(empty)).status is Status.NO_EDGE
    cv2.ellipse(circle, (middle[0] - 45 * end, middle[1]), (25, 36), 0.0, 0.0, 360.0, 0, -1, cv2.LINE_AA)
    light = 1.0 - 0.3 * cv2.GaussianBlur(circle / 255.0, (0, 0), 0.8)
    assert detect(Picture.from_array(empty * light), background=Picture.from_array(empty)).status is Status.DOUBLET


def test_the_rims_of_a_rear_are_not_taken_for_dirt():
    """Those of a capsule, in its plane, stick out from a smooth curve by 2 px on either side."""
    cases, seen = Database.open("square-neo-hookean").converged, []
    for number in (601, 609):
        view, camera = scenery(cases, np.random.default_rng([2026, number]))
        seen.append((view, *photograph(view, camera, seed=number)))
    scores, _ = off(seen, lambda view, picture, empty: picture)
    assert np.abs(scores).max() < 2.0
    assert len(scores) == 2
    _, statuses = off(seen, lambda view, picture, empty: specked(picture, end_of(view, -1.0)))
    assert statuses == [Status.DOUBLET] * 2


def test_dirt_anywhere_on_the_edge_is_refused_or_far_from_the_ends(scenes):
    random, refused = np.random.default_rng(3), 0
    for _ in range(3):
        scores, statuses = off(scenes, lambda view, picture, empty: spotted(picture, random.choice(edge_of(view)), 3))
        refused += len(statuses)
        assert set(statuses) == {Status.DOUBLET}
        assert np.abs(scores).max(initial=0.0) < 2.5
    assert refused >= 18


def test_of_a_membrane_seen_as_a_line_the_middle_is_the_edge():
    """Not of one that is dark within its edge, though the liquid inside be as bright as that outside."""
    cases, measured = Database.open("square-neo-hookean").converged, 0
    lines = ["the membrane as a line", "the same, darker inside"]
    for number in range(8):
        for drawn, shot in taken(cases, number, [*lines, "none", "as bright inside as outside"]):
            picture, empty = (Picture.from_array(grey) for grey in (shot.picture, shot.empty))
            found = detect(picture, background=empty)
            if not found.status.ok:
                continue
            away = found.lengths[0] - shot.view.axial_extent
            assert (found.line > 0.0) is (drawn in lines)
            assert abs(away) < 2.0 * np.sqrt(found.covariance[0, 0])
            if drawn in lines:  # the membrane may lie anywhere in a dark line, unless it is stated
                measured += 1
                stated = detect(picture, background=empty, by_hand=ByHand(edge_offset="0 +/- 0.1 px"))
                assert stated.lengths[0] == pytest.approx(found.lengths[0])
                assert abs(away) < max(0.5, 0.35 * shot.view.looks.line)
                assert stated.covariance[0, 0] < found.covariance[0, 0]
    assert measured >= 12


def test_a_smooth_bump_of_the_rear_that_is_measured_has_the_silhouette_of_no_capsule(scenes):
    """It makes L_z too long by many of its errors."""
    model, measured = Surrogate.open("square-neo-hookean", view="silhouette"), 0
    for view, picture, empty in scenes[:4]:
        spoiled, _ = bumped(picture, empty, view, np.random.default_rng(1))
        found = measure(spoiled, EXPERIMENT, capsule_velocity="6 +/- 0.1 mm/s", background=empty)
        if found.status.ok:
            measured += 1
            posterior = identify(found, model, EXPERIMENT, engine="quadrature", seed=1, error_budget=False)
            assert posterior.status is Status.OUTLINE_MISFIT
    assert measured >= 2


def test_black_and_white_pixels_do_no_harm(scenes):
    random = np.random.default_rng(5)
    scores, statuses = off(scenes, lambda view, picture, empty: salted(picture, empty, view, random)[0])
    assert not statuses
    assert np.count_nonzero(np.abs(scores) > 1.96) <= 1


def test_a_droplet_with_a_sharp_edge_is_measured(scenes):
    for number, (view, *_) in enumerate(scenes):
        looks = replace(view.looks, membrane=0.0, interior=0.5, rear=0.0, halo=0.0)
        picture, empty = photograph(replace(view, looks=looks), Camera(blur=0.3), seed=number)
        found = detect(Picture.from_array(picture), background=Picture.from_array(empty))
        assert abs(found.lengths[0] - view.axial_extent) < 2.5 * np.sqrt(found.covariance[0, 0])


def test_a_faint_capsule_is_measured_or_said_to_be_faint(scenes):
    """A tenth of the usual darkness in little noise; a droplet of 4 % of the light in noise of 1 %."""
    names, droplets = ("interior", "membrane", "rear", "halo"), 0
    for number, (view, *_) in enumerate(scenes):
        tenth = {name: 0.1 * getattr(view.looks, name) for name in names}
        droplet = dict.fromkeys(names, 0.0) | {"interior": 0.04}
        for dark, photons in ((tenth, 1e5), (droplet, 1e4)):
            camera = Camera(photons=photons, constant_noise=0.0)
            pictures = photograph(replace(view, looks=replace(view.looks, **dark)), camera, seed=number)
            picture, empty = map(Picture.from_array, pictures)
            found = detect(picture, background=empty)
            if dark is droplet and not found.status.ok:
                assert found.status is Status.NO_EDGE
            else:
                droplets += dark is droplet
                assert abs(found.lengths[0] - view.axial_extent) < 2.5 * np.sqrt(found.covariance[0, 0])
    assert droplets >= 6


@pytest.mark.parametrize("fringe", [{"membrane": -0.3}, {"membrane": -0.3, "halo": -0.15}])
def test_on_the_other_side_of_focus_the_edge_is_not_located(scenes, fringe):
    """A bright fringe lies on either side of the edge, and does not tell on which."""
    for number, (view, *_) in enumerate(scenes):
        looks = dict.fromkeys(("interior", "membrane", "rear", "halo"), 0.0) | fringe
        pictures = photograph(replace(view, looks=replace(view.looks, **looks)), Camera(), seed=number)
        picture, empty = map(Picture.from_array, pictures)
        assert detect(picture, background=empty).status is Status.NO_EDGE


def test_where_a_bright_fringe_lies_outside_a_darker_inside_the_edge_is_right_or_not_located(scenes):
    faint = dict.fromkeys(("membrane", "rear"), 0.0) | {"halo": 0.3, "interior": 0.05}
    for number, (view, *_) in enumerate(scenes):
        pictures = photograph(replace(view, looks=replace(view.looks, **faint)), Camera(), seed=number)
        picture, empty = map(Picture.from_array, pictures)
        found = detect(picture, background=empty)
        if found.status is not Status.NO_EDGE:
            assert abs(found.lengths[0] - view.axial_extent) < 2.0 * np.sqrt(found.covariance[0, 0])


@pytest.mark.parametrize("blur", [0.05, 0.2, 0.35])
def test_a_picture_sharper_than_its_pixels_is_measured(scenes, blur):
    measured = 0
    for number, (view, *_) in enumerate(scenes):
        picture, empty = photograph(view, Camera(blur=blur), seed=number)
        found = detect(Picture.from_array(picture), background=Picture.from_array(empty))
        if found.status is not Status.DOUBLET:  # steps of pixels may look like dirt
            measured += 1
            assert abs(found.lengths[0] - view.axial_extent) < 2.5 * np.sqrt(found.covariance[0, 0])
            assert np.sqrt(found.covariance[0, 0]) < 0.3
    assert measured >= 7


@pytest.mark.parametrize(("gamma", "held_without"), [(2.0, 6), (0.5, 2)])
def test_a_stated_gamma_brings_the_lengths_back(scenes, gamma, held_without):
    held = []
    for by_hand in (ByHand(gamma=gamma), None):
        found = []
        for view, *linear in scenes:
            grey = (np.rint(255.0 * (levels / 255.0) ** (1.0 / gamma)).astype(np.uint8) for levels in linear)
            picture, empty = map(Picture.from_array, grey)
            seen = detect(picture, background=empty, by_hand=by_hand)
            found.append((seen.lengths[0] - view.axial_extent) / np.sqrt(seen.covariance[0, 0]))
        held.append(np.count_nonzero(np.abs(found) < 1.96))
    assert held[0] >= len(scenes) - 1
    assert held[1] <= held_without


def test_where_two_capsules_overlap_is_no_capsule():
    cases, name = Database.open("square-neo-hookean").converged, "two capsules overlap"
    for number in (100, *CAPSULES):  # of the first, where both overlap is dark enough to be taken for a capsule
        for _, shot in taken(cases, number, [name]):
            found = detect(Picture.from_array(shot.picture), background=Picture.from_array(shot.empty))
            assert found.status in (Status.DOUBLET, Status.OVERLAP)


def test_two_capsules_overlap_where_the_inside_darkens_at_once():
    """A second nose without a dark membrane does not brighten again behind it; one capsule alone is measured."""
    cases = Database.open("square-neo-hookean").converged
    for number in (401, 404, 406, 408, 409):
        view, lens = scenery(cases, np.random.default_rng([2026, number]))
        plain = {"interior": 0.28, "membrane": 0.12, "membrane_width": 2.0, "rear": 0.2, "halo": 0.0}
        view = replace(view, looks=replace(view.looks, **plain))
        two, _ = overlapping(view, lens, np.random.default_rng([7, number]))
        for shown, status in ((view, Status.DONE), (two, Status.OVERLAP)):
            picture, empty = map(Picture.from_array, photograph(shown, lens, seed=number))
            assert detect(picture, background=empty).status is status


def test_broad_walls_and_what_is_darker_beyond_them_are_in_the_error_of_the_half_width(scenes):
    scores, sure = [], []
    for half_breadth in (1.5, 3.0, 4.0, 6.0, 7.0):
        for number, (view, *_) in enumerate(scenes):
            looks = replace(view.looks, wall_width=half_breadth, beyond=0.85)
            _, empty = photograph(replace(view, looks=looks), Camera(), seed=number)
            found = find_walls(empty.astype(float))
            scores.append((found.half_width - HALF_WIDTH) / found.half_width_error)
            sure.append(found.half_width_error < 0.005 * HALF_WIDTH)
    assert np.abs(scores).max() < 2.0
    assert np.mean(sure) >= 0.4  # up to walls of 9 px


def test_a_capsule_sheared_by_the_shutter_is_refused_or_less_sure(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: sheared(picture, empty, 4.0))
    assert set(statuses) <= {Status.LOPSIDED}
    assert np.abs(scores).max() < 2.5
    scores, statuses = off(scenes, lambda view, picture, empty: sheared(picture, empty, 8.0))
    assert len(scores) == 0
    assert Status.LOPSIDED in statuses


def test_a_capsule_askew_is_less_sure(scenes):
    scores, statuses = off(scenes, lambda view, picture, empty: turned(picture, empty, view, 2.0))
    assert len(statuses) <= 1  # next to the walls, which are not turned
    assert np.abs(scores).max() < 2.5


def test_of_a_capsule_askew_the_table_is_what_is_stored_and_of_a_lopsided_one_there_is_none(
    scenes, tmp_path, monkeypatch, capsys
):
    view, picture, empty = scenes[1]
    (tmp_path / "known.toml").write_text(
        'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 Pa s"\n'
    )
    cv2.imwrite(str(tmp_path / "empty.png"), empty)
    askew, lopsided = turned(picture, empty, view, 2.0), sheared(picture, empty, 8.0)
    for name, shown in (("plain", picture), ("askew", askew), ("lopsided", lopsided)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), shown)
        how = "--experiment", tmp_path / "known.toml", "--velocity", "6 +/- 0.1 mm/s", "--flow", "right"
        how = *how, "--background", tmp_path / "empty.png", "--out", tmp_path / name
        end, printed, _ = run(monkeypatch, capsys, "measure", tmp_path / f"{name}.png", *how)
        table = detect(Picture.from_array(shown), background=Picture.from_array(empty), flow="right").table()
        if name == "lopsided":
            assert end == 1
            assert "L_z" not in printed
            assert table.loc[["L_z", "L_a", "L_p"], ["value_px", "error_px", "error_over_l"]].isna().all(axis=None)
            continue
        stored = Measurement.read(tmp_path / name / "measurement.toml")
        errors = np.sqrt(np.diag(stored.covariance))
        for quantity, value, error in zip(("L_z", "L_a"), stored.lengths, errors, strict=True):
            row = table.loc[quantity]
            assert f"{value:.4f} ± {error:.4f}" in printed
            assert row["value_over_l"] == pytest.approx(value)
            assert row["error_over_l"] == pytest.approx(error)
            of_width = table.loc["l", "error_px"] * value
            assert np.hypot(row["error_px"], of_width) / table.loc["l", "value_px"] == pytest.approx(error)
        apart = np.array([1.0, -1.0])
        assert table.loc["L_p", "error_over_l"] == pytest.approx(np.sqrt(apart @ stored.covariance @ apart))
        assert (errors[0] > 0.01) == (name == "askew")


def test_a_particle_inside_is_not_taken_for_the_rear(scenes):
    seen = 0
    for view, picture, empty in scenes:
        behind = np.array(view.capsules[0].centre) - 0.1 * view.axial_extent * view.along
        found = detect(Picture.from_array(spotted(picture, behind, 7)), background=Picture.from_array(empty))
        if found.rear is not None:
            seen += 1
            assert abs(found.lengths[1] - view.axial_length) < 3.0 * np.sqrt(found.covariance[1, 1])
    assert seen >= 2


def test_a_plain_capsule_that_bears_a_dark_particle_is_measured(scenes):
    """It is less than half as dark as the particle, which alone would be taken for what is dark."""
    for number, (view, *_) in enumerate((scenes[0], scenes[1], scenes[3])):
        looks = replace(view.looks, interior=0.1, membrane=0.2, rear=0.15)
        picture, empty = photograph(replace(view, looks=looks), Camera(), seed=number)
        behind = np.array(view.capsules[0].centre) - 0.1 * view.axial_extent * view.along
        found = detect(Picture.from_array(spotted(picture, behind, 10)), background=Picture.from_array(empty))
        assert found.status is Status.DONE
        assert abs(found.lengths[0] - view.axial_extent) < 2.5 * np.sqrt(found.covariance[0, 0])


def test_a_rear_that_is_fainter_than_the_outer_edge_is_seen():
    """Of capsules that are concave by 20 px or more; where they are convex, none is."""
    cases, depths = Database.open("square-neo-hookean").converged, []
    for number in (402, 405, 406, 407, 409, 411, 412):
        view, lens = scenery(cases, np.random.default_rng([2026, number]))
        view = replace(view, looks=replace(view.looks, rear=0.1, membrane=0.5))
        picture, empty = map(Picture.from_array, photograph(view, lens, seed=number))
        found = detect(picture, background=empty)
        depths.append(view.axial_extent - view.axial_length)
        if depths[-1] < 1.0:
            assert found.rear is None
        else:
            assert abs(found.lengths[1] - view.axial_length) < 2.0 * np.sqrt(found.covariance[1, 1])
    assert np.count_nonzero(np.array(depths) > 20.0) == 4


def rough(monkeypatch, rms, over):
    """Let either wall wander by so many px rms, alike over so many px."""
    smooth, random = renderer.channel_of, np.random.default_rng(11)

    def channel_of(view):
        light = smooth(view)
        rows, columns = light.shape
        noise = gaussian_filter1d(random.standard_normal((2, columns)), renderer.FINE * over, axis=1, mode="wrap")
        inwards = renderer.FINE * rms * noise / noise.std(axis=1, keepdims=True)
        place = np.arange(rows)
        upper = place < renderer.FINE * view.capsules[0].centre[1]
        moved = [
            np.interp(place - np.where(upper, *inwards[:, column] * [1.0, -1.0]), place, light[:, column])
            for column in range(columns)
        ]
        return np.stack(moved, axis=1)

    monkeypatch.setattr(renderer, "channel_of", channel_of)


@pytest.mark.parametrize("over", [3.0, 10.0])
def test_walls_may_be_rough(monkeypatch, over):
    """Their roughness is in the error of l; before an estimated background, their bumps are no capsules."""
    cases = Database.open("square-neo-hookean").converged
    rough(monkeypatch, 1.5, over)
    for number in range(410, 414):
        view, lens = scenery(cases, np.random.default_rng([2026, number]))
        picture, empty = map(Picture.from_array, photograph(view, lens, seed=number))
        for background in (empty, None):
            found = detect(picture, background=background)
            assert found.status is Status.DONE
            assert abs(found.walls.half_width - HALF_WIDTH) < 2.0 * found.walls.half_width_error
            assert 0.5 < found.walls.half_width_error < 3.0
            assert abs(found.lengths[0] - view.axial_extent) < 2.5 * np.sqrt(found.covariance[0, 0])


def test_walls_that_bend_or_open_are_not_taken_for_rough_ones(scenes):
    """By 4 px from the middle to the borders, of smooth walls as of those with a roughness of 0.3 px."""
    random = np.random.default_rng(2)
    for _, _, empty in scenes[:2]:
        rows, columns = np.arange(empty.shape[0]), empty.shape[1]
        below, x = np.sign(rows - rows.mean()), np.linspace(-1.0, 1.0, columns)
        for rms in (0.0, 0.3):
            wander = rms * gaussian_filter1d(random.standard_normal(columns), 10.0) * np.sqrt(20.0 * np.sqrt(np.pi))
            for away in (4.0 * x**2 + wander, below[:, None] * (4.0 * x + wander)):
                away = np.broadcast_to(away, empty.shape)
                moved = [np.interp(rows + away[:, column], rows, empty[:, column]) for column in range(columns)]
                assert find_walls(np.stack(moved, axis=1)) is None


def test_a_bright_fringe_around_the_edge_is_told_and_a_slow_halo_widens_the_error_little(scenes):
    for view, picture, empty in scenes[:3]:
        errors = []
        bright, channel = photograph(replace(view, looks=replace(view.looks, halo=0.2)), Camera(), seed=1)
        slow, behind = photograph(replace(view, looks=replace(view.looks, halo=0.15, halo_width=4.0)), Camera(), seed=1)
        for shown, before, told in ((picture, empty, False), (bright, channel, True), (slow, behind, True)):
            found = measure(shown, EXPERIMENT, capsule_velocity="6 +/- 0.1 mm/s", background=before)
            assert ("A fringe" in found.doubt) is told
            errors.append(found.axial_extent_error)
        assert errors[0] < errors[2] < 2.5 * errors[0]


def through_microscope(condition, number):
    """What is detected in a picture that a lens makes, and the true L_z and L_a [px]."""
    cases = read_pool(POOL_FOLDER, "none", 0.0, "development").converged
    _, view, random = microscope.scenery(cases, condition, number)
    picture, empty = (Picture.from_array(each) for each in microscope.photograph(view, random))
    nose, rear = view.silhouette[:, 0].max(), view.profile[len(view.profile) // 2, 0]
    return detect(picture, background=empty), view.half_width * np.array([np.ptp(view.silhouette[:, 0]), nose - rear])


@pytest.mark.parametrize("number", [300, 301, 303])
def test_fringes_that_a_lens_makes_are_in_the_error(number):
    found, truth = through_microscope("strong rings", number)
    off, error = found.lengths[0] - truth[0], np.sqrt(found.covariance[0, 0])
    assert found.fringe > 0.08
    assert error > 1.0
    assert abs(off) < 2.0 * error


def test_what_may_be_a_thin_shell_has_it_in_the_errors_of_edge_and_rear():
    found, truth = through_microscope("a thin shell, incoherent", 300)
    assert found.line == 0.0
    assert found.rear.within > 0.4
    assert found.offset > 0.2
    assert np.all(np.abs(found.lengths[:2] - truth) < 2.5 * np.sqrt(np.diag(found.covariance)[:2]))


def test_a_dark_body_is_no_line_and_has_one_error_whatever_the_noise(scenes):
    _, _, empty = scenes[0]
    body, offsets = np.zeros(empty.shape, np.uint8), []
    cv2.circle(body, (empty.shape[1] // 2, empty.shape[0] // 2), 45, 255, -1, cv2.LINE_AA)
    light = 1.0 - 0.35 * cv2.GaussianBlur(body / 255.0, (0, 0), 0.8)
    for seed in range(5):
        noise = 1.0 + 0.004 * np.random.default_rng(seed).standard_normal(empty.shape)
        found = detect(Picture.from_array(empty * light * noise), background=Picture.from_array(empty))
        assert found.line == 0.0
        offsets.append(found.offset)
    assert np.ptp(offsets) < 0.1 * np.mean(offsets)
