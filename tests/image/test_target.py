"""The error that all edges share: seen as a ring of light outside them, measured with a target, or stated."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from command_line import mistake, run

from capsbayes.errors import InputError
from capsbayes.image import ByHand, Picture, detect, edge_offset_of
from capsbayes.image.measure import silhouette_of
from evidence.benchmarks.camera import Camera, Capsule, Looks, View, photograph

RINGS = {"halo": 0.2, "ring": 5.0, "ring_phase": 0.0}
PIXEL = "0.340 +/- 0.0002 um"
CIRCLE = np.stack([turn(np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)) for turn in (np.cos, np.sin)], axis=1)


def photographed(shape=CIRCLE, half_width=60.0, size=(200, 240), blur=1.2, wall=0.5, **looks):
    view = View((Capsule(shape, shape, (119.3, 99.8)),), half_width, size, looks=Looks(wall=wall, **looks))
    return view, *map(Picture.from_array, photograph(view, Camera(blur=blur), seed=3))


def bullet():
    """A blunt shape of 1.7 l by 1.6 l without a concave rear."""
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    front = np.cos(angle) > 0.0
    return np.stack([np.where(front, 1.05, 0.65) * np.cos(angle), 0.8 * np.sin(angle)], axis=1)


def disc(radius, **looks):
    """Picture of a disc between no walls."""
    plain = {"wall": 0.0, "beyond": 1.0, "unevenness": 0.0}
    return photographed(half_width=radius, **plain, **looks)[1]


def offset_of(picture, radius):
    return edge_offset_of(picture, f"{2.0 * 0.34 * radius:.4f} +/- 0.01 um", PIXEL)


@pytest.mark.parametrize("radius", [32.2, 61.7])
def test_a_target_tells_how_far_the_edge_lies_from_the_true_one(radius):
    plain, ringed = offset_of(disc(radius, halo=0.0), radius), offset_of(disc(radius, **RINGS), radius)
    assert plain.unit == "px"
    assert abs(plain.value) < 2.0 * plain.error < 0.15
    assert ringed.value > 3.0 * ringed.error
    other = offset_of(disc(45.0, **RINGS), 45.0)
    assert abs(ringed.value - other.value) < 2.0 * np.hypot(ringed.error, other.error)


def test_a_target_is_made_linear_by_a_stated_gamma():
    linear = disc(45.0, **RINGS)
    rooted = Picture.from_array(np.rint(np.sqrt(255.0 * linear.grey)).astype(np.uint8))
    found = edge_offset_of(rooted, "30.6 +/- 0.01 um", PIXEL, by_hand=ByHand(gamma=2.0))
    assert found.value == pytest.approx(offset_of(linear, 45.0).value, abs=0.02)
    assert found.value != pytest.approx(offset_of(rooted, 45.0).value, abs=0.03)


def test_a_ring_outside_the_edge_is_in_the_errors_and_a_stated_offset_takes_it_out():
    found = {}
    for name, looks in (("plain", {"halo": 0.0}), ("ringed", RINGS)):
        view, picture, empty = photographed(bullet(), **looks)
        found[name] = detect(picture, background=empty)
    plain, ringed = found.values()
    assert ringed.offset > 2.0 * plain.offset
    away = ringed.lengths[0] - view.axial_extent
    assert away < -0.25
    assert abs(away) < 2.0 * np.sqrt(ringed.covariance[0, 0])
    assert silhouette_of(ringed).pose.offset > 1.5 * silhouette_of(plain).pose.offset
    measured = offset_of(disc(45.0, **RINGS), 45.0)
    by_hand = ByHand(edge_offset=f"{measured.value} +/- {measured.error} px")
    stated = detect(picture, background=empty, by_hand=by_hand)
    assert stated.offset == pytest.approx(np.hypot(0.03, measured.error), rel=1e-3)
    assert stated.fringe == 0.0 < ringed.fringe
    assert abs(stated.lengths[0] - view.axial_extent) < 2.0 * np.sqrt(stated.covariance[0, 0])
    assert stated.covariance[0, 0] < 0.25 * ringed.covariance[0, 0]
    middles = [silhouette_of(each).points.mean(axis=0) for each in (ringed, stated)]
    radii = [
        np.hypot(*(silhouette_of(each).points - middle).T).mean()
        for each, middle in zip((ringed, stated), middles, strict=True)
    ]
    assert 60.0 * (radii[1] - radii[0]) == pytest.approx(measured.value, abs=0.05)


def test_what_nose_and_rear_share_counts_twice_in_the_length():
    _, picture, empty = photographed(bullet())
    one = detect(picture, background=empty)
    more = replace(one, offset=2.0)
    np.testing.assert_allclose((more.covariance - one.covariance)[:3, 0], [16.0, 8.0, 8.0], rtol=0.01)
    np.testing.assert_allclose(more.systematic_covariance[0, 0], more.covariance[0, 0], rtol=0.01)


def test_what_is_no_target_is_refused():
    for picture, message in (
        (photographed(bullet(), wall=0.0, beyond=1.0)[1], "expected a round target, got an outline"),
        (
            Picture.from_array(np.full((120, 120), 100, dtype=np.uint8)),
            "expected one round target in its middle, got no",
        ),
    ):
        with pytest.raises(InputError, match=message):
            offset_of(picture, 40.0)


def test_the_command_says_what_to_state(tmp_path, monkeypatch, capsys):
    experiment, picture = tmp_path / "e.toml", tmp_path / "disc.png"
    experiment.write_text('cross_section = "square"\nviscosity = "0.7 +/- 0.01 Pa s"\nhalf_width = "50 +/- 0.1 um"\n')
    cv2.imwrite(str(picture), disc(45.0, **RINGS).grey.astype(np.uint8))
    target = ("measure", picture, "--experiment", experiment, "--target", "30.6 +/- 0.01 um")
    status, said, _ = run(monkeypatch, capsys, *target, "--pixel-size", PIXEL)
    assert status == 0
    assert "px outside the located one" in said
    stated = ByHand(edge_offset=said.split('--edge-offset "')[1].split('"')[0]).edge_offset
    assert stated.mean == pytest.approx(offset_of(disc(45.0, **RINGS), 45.0).value, abs=0.006)
    told = json.loads(run(monkeypatch, capsys, *target, "--pixel-size", PIXEL, "--json")[1])["edge_offset"]
    assert (told["value"], told["error"]) == pytest.approx((stated.mean, stated.sd), abs=0.006)
    assert "--flow" in mistake(monkeypatch, capsys, *target, "--pixel-size", PIXEL, "--flow", "left")
    assert "--out" in mistake(monkeypatch, capsys, *target, "--pixel-size", PIXEL, "--out", tmp_path / "out")
    assert "expected --pixel-size with it" in mistake(monkeypatch, capsys, *target)
    assert "--velocity" in mistake(monkeypatch, capsys, *target, "--pixel-size", PIXEL, "--velocity", "6 +/- 0.1 mm/s")
