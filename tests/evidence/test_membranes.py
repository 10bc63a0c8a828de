"""The recipe of the states over the membrane: it gives the shipped states again."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from capsbayes.errors import InputError
from capsbayes.membrane_database import FREE_PARAMETERS, THICK, MembraneDatabase, covered
from capsbayes.physics.scattered import membrane_continuation, nearest_state
from capsbayes.surrogate import MembraneSurrogate
from evidence.rebuild import (
    MembraneRecipe,
    build_membranes,
    membrane_places,
    needed_places,
    refined_states,
    spread_points,
    with_mesh_errors,
)


def test_places_lie_where_states_are_sought():
    continuation = membrane_continuation("square")
    values = continuation.values(membrane_places(continuation, (512, 256), (64, 32)))
    assert covered(values[1:]).all()  # the first is a corner
    assert np.all(values[:768, -1] <= THICK * (1.0 + 1e-12))
    assert np.all(values[768:, -1] >= THICK * (1.0 - 1e-12))


def test_border_points_follow_the_others_and_reach_every_face():
    points = spread_points(512, 256)
    np.testing.assert_array_equal(points[:512], spread_points(512, 0))
    inner, outer = points[:512, 1:], points[512:, 1:]
    assert np.all(np.sum((inner == 0.0) | (inner == 1.0), axis=0) <= 1)
    moved = (outer == 0.0) | (outer == 1.0)
    assert np.all((outer[~moved] >= 0.2) & (outer[~moved] <= 0.8))
    for end in (0.0, 1.0):
        assert np.all(np.abs(np.mean(outer == end, axis=0) - 0.2) < 0.02)


def test_needed_places_are_those_of_the_largest_errors_and_apart():
    shipped, continuation = MembraneDatabase.open("circular"), membrane_continuation("circular")
    places = needed_places(shipped, continuation, 20)
    values = continuation.values(places)
    assert pdist(places).min() > 0.3
    assert covered(values, "circular").all()
    model = MembraneSurrogate(shipped)
    needed, stored = (
        np.trace(model(dict(zip(FREE_PARAMETERS, each.T, strict=True))).covariance, axis1=1, axis2=2)
        for each in (values, 0.9 * shipped["values"] + 0.1 * shipped["values"].mean(axis=0))
    )
    assert np.nanmin(needed) > np.nanquantile(stored, 0.9)


@pytest.mark.parametrize("cross_section", ["square", "circular"])
def test_a_shipped_state_is_a_steady_state_and_has_the_derivatives_that_are_stored(cross_section):
    """Found again from the stored shape, and again a step away."""
    shipped = MembraneDatabase.open(cross_section)
    continuation = membrane_continuation(cross_section, shipped.settings["refinement"])
    chosen = int(np.argmin(np.abs(shipped["values"][:, 0] - 0.05)))
    values = shipped["values"][chosen]
    place = continuation.places(values[None])[0]
    near = nearest_state(shipped, continuation, place + 1e-3)
    np.testing.assert_array_equal(near.place, place)
    state = continuation.reached(near, place)
    assert state is not None
    np.testing.assert_allclose(state.unknowns[:-2], near.unknowns[:-2], atol=5e-3)
    assert state.unknowns[-2] == pytest.approx(shipped["numbers"][chosen, 2], rel=1e-5)
    ahead = continuation.reached(state, place + 1e-3)
    slopes = [axis.slope(unit) for axis, unit in zip(continuation.axes, place, strict=True)]
    rate = shipped["numbers_along"][chosen, 2] * slopes
    assert (ahead.unknowns[-2] - state.unknowns[-2]) / 1e-3 == pytest.approx(rate.sum(), rel=0.02, abs=1e-3)


def test_a_shipped_state_is_found_again_on_a_finer_mesh_and_kept(tmp_path):
    shipped, finer = MembraneDatabase.open("square"), membrane_continuation("square", 14)
    chosen = int(np.argmin(np.abs(shipped["values"][:, 0] - 0.05) + shipped["values"][:, 2]))  # hardly inflated
    here = {"folder": tmp_path / "parts", "scheduler": "synchronous", "progress": False}
    [state] = refined_states(shipped.taken([chosen]), finer, **here)
    assert len(state.unknowns) > len(shipped["mesh_mean"]) + 2
    np.testing.assert_allclose(finer.values(state.place[None])[0], shipped["values"][chosen], rtol=1e-12)
    again = finer.reached(state, state.place + 1e-3, derivatives=False)
    np.testing.assert_allclose(state.moved(np.full(6, 1e-3)).unknowns, again.unknowns, atol=2e-5)
    numbers = finer.seen(state)["numbers"]
    np.testing.assert_allclose(numbers, shipped["numbers"][chosen], rtol=0.01)
    assert np.abs(numbers / shipped["numbers"][chosen] - 1.0).max() > 1e-5  # the error of the coarse mesh
    [kept] = refined_states(shipped.taken([chosen]), finer, **here)
    np.testing.assert_array_equal(kept.unknowns, state.unknowns)
    assert len(list((tmp_path / "parts").glob("*.part"))) == 1


def test_the_error_of_a_mesh_is_a_share_of_the_change_from_a_coarser_one():
    fine = MembraneDatabase.open("circular").taken(np.arange(20)).dataset
    moved = fine.assign(numbers=fine["numbers"] - 0.01, silhouette_mean=fine["silhouette_mean"] + [0.02, 0.0])
    dataset = with_mesh_errors(fine, MembraneDatabase(moved.isel(state=slice(None, None, -1))))
    np.testing.assert_allclose(dataset["numbers_mesh_error"], 0.004, rtol=1e-9)
    np.testing.assert_allclose(dataset["profile_mesh_error"], 0.0, atol=1e-7)
    seen = np.einsum("nm,mpi->npi", dataset["silhouette_mesh_error"], fine["silhouette_modes"])
    assert np.mean(seen, axis=(0, 1)) == pytest.approx([-0.008, 0.0], abs=1e-4)
    few = with_mesh_errors(fine.isel(state=slice(15), lost_state=slice(0)), MembraneDatabase(moved))
    np.testing.assert_allclose(few["numbers_mesh_error"][15:], 0.01, rtol=1e-9)  # of the last, the whole mean change
    np.testing.assert_allclose(few["silhouette"], fine["silhouette"], atol=1e-4)
    for name in ("values", "numbers", "profile_along", "tension", "lost"):
        np.testing.assert_allclose(few[name], fine[name], atol=1e-6)
    np.testing.assert_allclose(few["mesh"], fine["mesh"], atol=0.01)  # a start, smoothed
    with pytest.raises(InputError, match="none for 5"):
        with_mesh_errors(fine, MembraneDatabase(moved.isel(state=slice(5, None))))


@pytest.mark.slow
def test_a_small_one_is_built_and_read(tmp_path, monkeypatch):
    further = np.array([[0.4], [0.45]]) * np.ones(6)  # so few states have no model that says where more are needed
    monkeypatch.setattr("evidence.rebuild.needed_places", lambda *arguments: further)
    few = MembraneRecipe("square", (2, 1), (1, 1), needed=2, refinement=5, coarse=4)
    built = build_membranes(few, out=tmp_path / "few.nc", scheduler="synchronous")
    again = MembraneDatabase.open(tmp_path / "few.nc")
    assert again.sha256 == built.sha256
    assert built.as_dict()["states"] + built.as_dict()["lost"] == 7
    assert (tmp_path / "few.nc.needed.parts").is_dir()
    assert built.settings["refinement"] == 5
    assert np.all(np.any(built["profile_mesh_error"] != 0.0, axis=1))
