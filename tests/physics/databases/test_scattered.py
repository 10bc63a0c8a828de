"""Scattered states are those of the simulator, found again after an interruption, and predict their neighbours."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.physics.membrane import GeneralLaw
from capsbayes.physics.scattered import (
    Axis,
    Continuation,
    ScatteredState,
    in_modes,
    scattered_dataset,
    scattered_states,
)
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.run import Store
from evidence.rebuild import sobol_places

HERE = {"scheduler": "synchronous", "progress": False}
AXES = (
    Axis("capillary_number", 0.04, 0.06, offset=0.0),
    Axis("size_ratio", 0.75, 0.8),
    Axis("pre_inflation", 0.0, 0.03, offset=0.01),
    Axis("strain_hardening", 0.0, 0.5),
)
SIMULATOR = Simulator(
    GeneralLaw(3.0, 0.1),
    refinement=4,
    bending=3e-3,
    pre_inflation=0.01,
    walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5),
)
CONTINUATION = Continuation(SIMULATOR, AXES)
PLACES = sobol_places(8, len(AXES))


@pytest.fixture(scope="module")
def start():
    return CONTINUATION.taken(SIMULATOR.run(capillary_number=0.05, size_ratio=0.78))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("scattered")


@pytest.fixture(scope="module")
def states(start, folder):
    return scattered_states(CONTINUATION, start, PLACES, folder=folder, **HERE)


def test_states_are_those_of_the_simulator(states):
    for place, state in zip(PLACES[:3], states, strict=False):
        ca, size, inflation, hardening = (axis.value(unit) for axis, unit in zip(AXES, place, strict=True))
        law = GeneralLaw(3.0, hardening)
        alone = Simulator(law, refinement=4, bending=3e-3, pre_inflation=inflation, walls=SIMULATOR.walls)
        wanted = CONTINUATION.taken(alone.run(capillary_number=ca, size_ratio=size)).unknowns
        np.testing.assert_allclose(state.unknowns, wanted, atol=1e-5)


def test_a_state_predicts_its_neighbours_to_second_order(start):
    direction = np.array([0.5, -0.3, 0.4, 0.2])
    errors = []
    for step in (0.2, 0.1):
        state = CONTINUATION.reached(start, start.place + step * direction)
        predicted = start.unknowns + start.derivatives @ (step * direction)
        errors.append(np.abs(predicted - state.unknowns).max())
    assert 3.0 < errors[0] / errors[1] < 5.5


def test_what_is_missing_is_computed_again(start, states, folder):
    parts = sorted(folder.glob("state-*.part"))
    assert len(parts) == len(PLACES)
    for part in parts[::2]:
        part.unlink()
    before = {part: part.stat().st_mtime_ns for part in parts[1::2]}
    again = scattered_states(CONTINUATION, start, PLACES, folder=folder, **HERE)
    for state, other in zip(states, again, strict=True):
        np.testing.assert_allclose(other.unknowns, state.unknowns, atol=1e-6)
    assert {part: part.stat().st_mtime_ns for part in before} == before


def test_a_place_that_was_not_reached_is_tried_again_from_the_nearest_state(
    start, states, folder, tmp_path, monkeypatch
):
    """As where the first way to it leads over a fold, and another one does not."""
    copy, honest, refused = shutil.copytree(folder, tmp_path / "copy"), Continuation.reached, []
    name = next(part.name for part in copy.glob("state-*.part") if _holds(copy, part, PLACES[5]))
    (copy / name).unlink()

    def at_the_second_time(self, near, place, **options):
        if np.array_equal(place, PLACES[5]) and not refused:
            return refused.append(near)
        return honest(self, near, place, **options)

    monkeypatch.setattr(Continuation, "reached", at_the_second_time)
    found = scattered_states(CONTINUATION, start, PLACES, folder=copy, **HERE)
    assert len(refused) == 1
    np.testing.assert_allclose(found[5].unknowns, states[5].unknowns, atol=1e-5)
    assert _reached(copy) == sorted(tuple(place) for place in PLACES)
    monkeypatch.setattr(Continuation, "reached", lambda *_: pytest.fail("all is kept"))
    again = scattered_states(CONTINUATION, start, PLACES, folder=copy, **HERE)
    np.testing.assert_array_equal(again[5].unknowns, found[5].unknowns)


def _reached(folder):
    store = Store.open(folder, CONTINUATION.settings)
    parts = [store.load(name) for name in store.names()]
    return sorted(tuple(part["place"]) for part in parts if part["reached"])


def _holds(folder, part, place):
    kept = Store.open(folder, CONTINUATION.settings).load(part.stem)
    return kept is not None and np.array_equal(kept["place"], place)


def test_the_dataset_holds_what_is_seen_of_the_states_and_its_derivatives(states, start):
    lost = np.full((1, len(AXES)), 0.25)
    dataset = scattered_dataset(CONTINUATION, np.concatenate([PLACES, lost]), [*states, None])
    assert dataset.sizes["state"] == len(states)
    np.testing.assert_allclose(dataset["lost"][0, :2], [0.04 * 1.5**0.25, 0.7625], rtol=1e-12)
    np.testing.assert_allclose(dataset["values"][:, 2], 0.01 * (4.0 ** PLACES[:, 2] - 1.0), atol=1e-15)
    meshes = dataset["mesh_mean"].values + dataset["mesh"].values @ dataset["mesh_modes"].values
    np.testing.assert_allclose(meshes, [state.unknowns[:-2] for state in states], atol=1e-3)
    chosen = int(np.argmin(np.linalg.norm(PLACES - start.place, axis=1)))
    for step in (1e-3, -1e-3):
        ca, size, inflation, hardening = (float(value) for value in dataset["values"][chosen])
        law = GeneralLaw(3.0, hardening + 10 * step)
        simulator = Simulator(law, refinement=4, bending=3e-3, pre_inflation=inflation, walls=SIMULATOR.walls)
        state = simulator.run(capillary_number=ca * (1.0 + step), size_ratio=size)
        change = dataset["numbers_along"].values[chosen] @ [ca * step, 0.0, 0.0, 10 * step]
        seen = state.profile
        wanted = [seen.axial_extent, seen.axial_length, state.velocity_ratio, seen.stretch_ratio(size)]
        np.testing.assert_allclose(dataset["numbers"].values[chosen] + change, wanted, atol=5e-5)
        tensions = state.principal_tensions
        change = dataset["tension_along"].values[chosen] @ [ca * step, 0.0, 0.0, 10 * step]
        wanted = [tensions.max(), tensions.min()]
        np.testing.assert_allclose(dataset["tension"].values[chosen] + change, wanted, atol=5e-4)
        for view in ("profile", "silhouette"):
            along = dataset[f"{view}_along"].values[chosen] @ [ca * step, 0.0, 0.0, 10 * step]
            modes = dataset[view].values[chosen] + along
            outline = dataset[f"{view}_mean"].values + np.tensordot(modes, dataset[f"{view}_modes"].values, axes=1)
            np.testing.assert_allclose(outline, getattr(state, view).resampled(len(outline)).points, atol=3e-4)


def test_the_tensions_lie_where_the_membrane_bears_them(states):
    state = states[0]
    dataset = scattered_dataset(CONTINUATION, PLACES, states)
    values = dict(zip(CONTINUATION.names, CONTINUATION.values(PLACES[:1])[0], strict=True))
    simulator = Simulator(
        GeneralLaw(3.0, values["strain_hardening"]),
        refinement=4,
        bending=3e-3,
        pre_inflation=values["pre_inflation"],
        walls=SIMULATOR.walls,
    )
    alone = simulator.run(capillary_number=values["capillary_number"], size_ratio=values["size_ratio"])
    for extreme, node in enumerate((alone.principal_tensions.argmax(), alone.principal_tensions.argmin())):
        tension, place = dataset["tension"].values[0, extreme], dataset["tension_place"].values[0, extreme]
        assert tension == pytest.approx(alone.principal_tensions.flat[node], abs=1e-5)
        x, y, z = alone.mesh.expanded(alone.mesh.reduced(alone.nodes))[node // 2]
        np.testing.assert_allclose([np.hypot(*place[:2]), place[2]], [np.hypot(x, y), z], atol=1e-4)
    np.testing.assert_array_equal(CONTINUATION.extreme_tensions(state).places, dataset["tension_place"].values[0])


def test_a_branch_that_ends_on_the_way_is_said(start, monkeypatch):
    """As where Newton's method finds nothing beyond the middle of the way."""
    middle = start.place[0] + 0.2

    def until_the_fold(self, near, place, derivatives):
        return None if place[0] > middle else ScatteredState(place, near.unknowns, near.derivatives)

    monkeypatch.setattr(Continuation, "_solved", until_the_fold)
    assert CONTINUATION.reached(start, start.place + 0.4 * np.eye(4)[0]) is None
    assert CONTINUATION.reached(start, start.place + 0.1 * np.eye(4)[0]) is not None


def test_derivatives_that_lead_out_of_the_channel_are_not_followed(start):
    """As of a shape that is no state on the mesh, whose membrane would bear no finite forces there."""
    wild = replace(start, derivatives=1e160 * start.derivatives)
    assert CONTINUATION.reached(wild, start.place + 0.1) is None


def test_axes_without_the_case_are_refused():
    with pytest.raises(InputError, match="size_ratio among the axes, got capillary_number"):
        Continuation(SIMULATOR, AXES[:1])


def test_a_parameter_that_the_membrane_lacks_is_refused():
    with pytest.raises(InputError, match=r"axes: expected some of .*pre_inflation.*, got 'area_dilation_modulus'"):
        Continuation(Simulator(refinement=4), (*AXES[:2], Axis("area_dilation_modulus", 1.0, 5.0)))


def test_a_state_without_derivatives_is_the_same(start):
    place = start.place + 0.1
    found = CONTINUATION.reached(start, place, derivatives=False)
    np.testing.assert_allclose(found.unknowns, CONTINUATION.reached(start, place).unknowns, atol=1e-6)
    assert np.all(np.isnan(found.derivatives))


def test_vectors_in_modes_leave_out_no_more_than_is_said():
    vectors = np.random.default_rng(3).standard_normal((20, 8)) * 10.0 ** -np.arange(8)
    few, many = in_modes(vectors, 1e-3), in_modes(vectors, 1e-6)
    assert len(few.modes) < len(many.modes)
    for modes, omitted in ((few, 1e-3), (many, 1e-6)):
        away = modes.mean + modes.coefficients @ modes.modes - vectors
        assert np.sqrt(np.mean(away**2)) <= omitted
