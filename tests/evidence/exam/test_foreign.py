"""Faults that the catalogue lacks do to a capsule what they say."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.diagnosis.blind import Capsule, Lab, draw_session
from capsbayes.profile import signed_area
from evidence.exam.foreign import FOREIGN, PATTERN, smooth_pattern

LAB = Lab()
ANGLE = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
WAVY = 0.9 + 0.01 * np.cos(12 * ANGLE)
CAPSULE = Capsule(
    capillary_number=0.05, size_ratio=0.9, surface_shear_modulus=0.05, capsule_radius=2e-5, capsule_velocity=4e-3,
    velocity_seen=4e-3, flow_rate=1e-11, outline=np.stack([WAVY * np.cos(ANGLE), WAVY * np.sin(ANGLE)], axis=1),
)  # fmt: skip


def seen(name, size, capsule=CAPSULE):
    return FOREIGN[name][0].drawn(capsule, size, LAB, 1)


@pytest.mark.parametrize("name", ["walls read wrongly", "focus that changes"])
def test_the_first_recording_is_as_it_was(name):
    first, second = (seen(name, 0.02, replace(CAPSULE, place=place)).outline for place in (0.2, 0.8))
    np.testing.assert_array_equal(first, CAPSULE.outline)
    assert signed_area(second) / signed_area(first) == pytest.approx(1.02 ** (-2 if "walls" in name else 2), rel=5e-3)


def test_walls_read_too_far_apart_slow_the_capsule_as_well():
    assert seen("walls read wrongly", 0.02, replace(CAPSULE, place=0.8)).velocity_seen == pytest.approx(4e-3 / 1.02)


def test_smoothing_takes_short_waves_and_leaves_long_ones():
    radius = np.hypot(*seen("smoothed outlines", 0.08).outline.T)
    kept = np.exp(-0.5 * (0.08 * 12 / 0.9) ** 2)
    assert np.ptp(radius) == pytest.approx(kept * np.ptp(WAVY), rel=0.1)
    assert radius.mean() == pytest.approx(0.9, rel=0.01)


def test_the_rear_alone_is_seen_further_back():
    moved = seen("rear edge", 0.02).outline - CAPSULE.outline
    behind = CAPSULE.outline[:, 0] < CAPSULE.outline[:, 0].mean()
    assert np.all(moved[~behind] == 0.0)
    assert np.all(moved[:, 1] == 0.0)
    assert moved[:, 0].min() == pytest.approx(-0.02, rel=0.05)


def test_a_rolling_shutter_shears_fast_capsules_more():
    slow, fast = (seen("rolling shutter", 0.04, replace(CAPSULE, capsule_velocity=u)).outline for u in (2e-3, 4e-3))
    np.testing.assert_allclose(fast - CAPSULE.outline, 2.0 * (slow - CAPSULE.outline), atol=1e-12)
    assert signed_area(fast) == pytest.approx(signed_area(CAPSULE.outline))


def test_a_viscosity_that_drifts_slows_later_capsules_at_the_same_ca():
    early, late = (seen("viscosity that drifts", 0.3, replace(CAPSULE, place=place)) for place in (0.0, 1.0))
    assert early.velocity_seen / late.velocity_seen == pytest.approx(np.exp(0.3))
    assert early.velocity_seen * late.velocity_seen == pytest.approx(CAPSULE.velocity_seen**2)
    assert early.flow_rate / late.flow_rate == pytest.approx(np.exp(0.3))
    assert late.surface_shear_modulus == CAPSULE.surface_shear_modulus


def test_the_capsules_of_two_batches_are_soft_or_stiff():
    effect, size = FOREIGN["two batches"]
    narrow = replace(LAB, spread=0.08)
    blind = draw_session(
        Database.open("square-neo-hookean"), effect, size, lab=narrow, capsules=40, seed=1, outline=False
    )
    away = np.abs(blind.log_modulus - np.log(LAB.surface_shear_modulus))
    assert away.mean() == pytest.approx(0.5 * np.log(2.0), abs=0.1)
    assert np.mean(away < 0.1) < 0.1


def test_a_pattern_moves_edges_along_their_normals_alike_for_all_capsules():
    moved = PATTERN.drawn(CAPSULE, 0.02, LAB, 3).outline - CAPSULE.outline
    np.testing.assert_allclose(moved, 0.02 * smooth_pattern(CAPSULE.outline, 3))
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(0.02, rel=0.01)
