import meshio
import numpy as np
import pytest

from capsbayes import Simulator
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.physics.channel import SquareChannel
from capsbayes.physics.membrane import NeoHookean, Skalak
from capsbayes.physics.simulator import save_series
from capsbayes.physics.steady import FreeMotion, Iterate, Problem
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.physics.transient import STEADY, growth_rates, stable_step, transient

COARSE_WALLS = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)
SIMULATOR = Simulator(refinement=4, bending=1e-3, walls=COARSE_WALLS)
PROBLEM = SIMULATOR.problem
CA, SIZE = 0.08, 0.8


@pytest.fixture(scope="module")
def steady():
    return SIMULATOR.run(capillary_number=CA, size_ratio=SIZE)


@pytest.fixture(scope="module")
def developed():
    """A shape on its way, past the first snapshots after rest."""
    (end,) = transient(PROBLEM, PROBLEM.at_rest(CA, SIZE), [0.3])
    return end.iterate


@pytest.fixture(scope="module")
def arriving(steady):
    """Instants of a capsule whose capillary number was raised by a third and that has nearly settled again."""
    before = SIMULATOR.run(capillary_number=0.06, size_ratio=SIZE, start=steady)
    start = Iterate(before.mesh.reduced(before.nodes), 0.0, 0.0, CA, SIZE)
    return list(transient(PROBLEM, start, [2.0, 3.0, 20.0], step=0.5))


def test_volume_and_centroid_are_held(arriving):
    for instant in arriving:
        inside = PROBLEM.membrane(SIZE).enclosure(instant.iterate.free)
        assert inside.volume == pytest.approx(4 / 3 * np.pi * SIZE**3, rel=1e-7)
        assert inside.moment == pytest.approx(0.0, abs=1e-7)


def test_the_end_is_the_steady_state_of_newton(arriving, steady):
    end = arriving[-1]
    assert end.time < 20.0
    assert end.speed < STEADY
    np.testing.assert_allclose(end.iterate.free, steady.mesh.reduced(steady.nodes), atol=3e-4)
    assert end.iterate.velocity == pytest.approx(steady.velocity_ratio, abs=1e-4)
    assert end.iterate.slack == pytest.approx(steady.slack, abs=1e-4)


def test_the_slowest_growth_rate_is_that_of_the_last_approach(arriving, steady):
    at_rest = steady.mesh.reduced(steady.nodes)
    rates = growth_rates(PROBLEM, Iterate(at_rest, steady.velocity_ratio, steady.slack, CA, SIZE))
    first, second = (np.linalg.norm(instant.iterate.free - at_rest) for instant in arriving[:2])
    assert len(rates) == len(at_rest) - 2
    assert rates[0].real < 0
    assert np.log(second / first) == pytest.approx(rates[0].real, rel=0.05)


@pytest.mark.parametrize(("scheme", "longest", "count"), [("semi-implicit", 0.05, 4), ("explicit", None, 6)])
def test_both_schemes_are_of_second_order(developed, scheme, longest, count):
    longest = longest or 0.5 * stable_step(PROBLEM, developed)
    ends = []
    for halvings in range(3):
        step = longest / 2**halvings
        (end,) = transient(PROBLEM, developed, [count * longest], scheme=scheme, step=step, tolerance=np.inf)
        ends.append(end.iterate.free)
    changes = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    assert np.log2(changes[0] / changes[1]) == pytest.approx(2.0, abs=0.3)


def test_explicit_and_semi_implicit_steps_agree(developed):
    explicit, implicit = (
        list(transient(PROBLEM, developed, [0.05], scheme=scheme))[-1] for scheme in ("explicit", "semi-implicit")
    )
    np.testing.assert_allclose(implicit.iterate.free, explicit.iterate.free, atol=1e-3)
    assert implicit.iterate.velocity == pytest.approx(explicit.iterate.velocity, abs=5e-4)


@pytest.mark.parametrize("law", [NeoHookean(), Skalak(10.0)])
@pytest.mark.parametrize("bending", [0.0, 5e-3])
@pytest.mark.parametrize("refinement", [4, 6])
def test_the_explicit_step_is_stable_and_not_far_too_short(law, bending, refinement):
    problem = Problem(law, SquareChannel(), refinement, bending, walls=COARSE_WALLS)
    start = problem.at_rest(0.05, 0.9)
    fastest = np.max(np.abs(np.linalg.eigvals(FreeMotion(problem, start).linearised(start.free)[1])))
    assert 0.9 < fastest * stable_step(problem, start) < 1.5


@pytest.mark.parametrize("tolerance", [1e-3, np.inf])
def test_a_mesh_distorted_beyond_use_is_said(tolerance):
    start = PROBLEM.at_rest(CA, SIZE)
    folded = Iterate(start.free * np.where(np.arange(len(start.free)) % 2, 1.0, 0.01), 0.0, 0.0, CA, SIZE)
    with pytest.raises(CapsbayesError, match=r"no step is short enough at U t/l = 0; refine the mesh"):
        list(transient(PROBLEM, folded, [1.0], tolerance=tolerance))


def test_the_simulator_follows_a_capsule_from_rest_and_from_any_snapshot(tmp_path):
    case = {"capillary_number": CA, "size_ratio": SIZE}
    snapshots = list(SIMULATOR.transient(**case, until=0.25))
    assert [snapshot.time for snapshot in snapshots] == pytest.approx([0.0, 0.1, 0.2, 0.25])
    assert snapshots[0].profile.axial_extent == pytest.approx(2 * SIZE, rel=1e-6)
    *_, later = SIMULATOR.transient(**case, until=0.05, start=snapshots[2])
    assert later.velocity_ratio == pytest.approx(snapshots[3].velocity_ratio, abs=2e-3)
    series = save_series(snapshots, tmp_path / "way.pvd")
    assert 'timestep="0.25" file="way-0003.vtu"' in series.read_text()
    assert np.ptp(meshio.read(tmp_path / "way-0003.vtu").points[:, 2]) == pytest.approx(
        snapshots[3].silhouette.axial_extent, rel=0.01
    )


def test_a_sphere_that_does_not_fit_is_squeezed():
    first = next(SIMULATOR.transient(capillary_number=CA, size_ratio=1.1, until=1.0))
    points = first.surface_nodes
    assert points[:, 0].max() == pytest.approx(0.95, rel=1e-3)
    assert np.prod(points.max(axis=0)) == pytest.approx(1.1**3, rel=3e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"viscosity_ratio": 5.0}, "viscosity_ratio: expected 1, because the double layer of liquids of unequal"),
        ({"viscosity_ratio": 5.0}, "got 5; the steady shape does not depend on it"),
        ({"scheme": "implicit"}, "scheme: expected one of semi-implicit, explicit, got 'implicit'"),
        ({"until": -1.0}, "until: expected a number between 0 and 1000, got -1"),
    ],
)
def test_impossible_transients_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        SIMULATOR.transient(**{"capillary_number": CA, "size_ratio": SIZE, "until": 1.0} | wrong)
