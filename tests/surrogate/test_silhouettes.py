"""The same surrogate with the outlines that a photograph shows."""

from dataclasses import replace

import manufactured
import numpy as np
import pytest

from capsbayes.database import Database
from capsbayes.effects import Halo
from capsbayes.errors import InputError
from capsbayes.surrogate import Surrogate
from capsbayes.surrogate.diffuse import PlaneScaling, leave_one_out
from capsbayes.surrogate.plane import OUTLINES, approximation_of, branches_of

LARGER = 1.1
PLACE = {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9])}
POINT = {"capillary_number": 0.05, "size_ratio": 0.9}


@pytest.fixture(scope="module")
def both():
    """The manufactured map with silhouettes that are larger than the mid-plane outlines, in both views."""
    dataset = manufactured.database(mesh_error=manufactured.MESH_ERROR).dataset.copy(deep=True)
    dataset["silhouette"].values[:] *= LARGER
    database = Database(dataset)
    return Surrogate(database), Surrogate.from_database(database, view="silhouette")


def test_only_the_outlines_differ(both):
    mid_plane, silhouette = (model(PLACE, outline=True) for model in both)
    np.testing.assert_allclose(silhouette.outline, LARGER * mid_plane.outline, rtol=1e-9)
    np.testing.assert_array_equal(silhouette.values, mid_plane.values)
    np.testing.assert_array_equal(silhouette.covariance, mid_plane.covariance)


def test_the_view_is_in_the_name_and_the_mid_plane_is_the_default(both):
    mid_plane, silhouette = both
    assert (mid_plane.view, silhouette.view) == ("mid-plane", "silhouette")
    assert (mid_plane.name, silhouette.name) == ("square-manufactured", "square-manufactured (silhouettes)")
    assert silhouette.sha256 == mid_plane.sha256 == mid_plane.database.sha256
    assert ((mid_plane + Halo()).view, (silhouette + Halo()).view) == ("mid-plane", "silhouette")


def test_own_errors_are_those_of_the_view_and_the_rear_on_the_axis_is_hidden(both):
    mid_plane, silhouette = (model.outline_modes(**POINT) for model in both)
    assert len(silhouette) == len(mid_plane) - 1
    np.testing.assert_allclose(silhouette[:-1], LARGER * mid_plane[:-2], rtol=1e-6, atol=1e-12)


def test_another_word_is_refused(both):
    with pytest.raises(InputError, match='Surrogate: view: expected "mid-plane" or "silhouette", got \'shadow\''):
        Surrogate(both[0].database, view="shadow")
    with pytest.raises(InputError, match='view: expected "mid-plane" or "silhouette"'):
        Surrogate.open("square-neo-hookean", view="shadow")


@pytest.mark.slow
def test_an_effect_database_predicts_silhouettes_too():
    database = Database.open("square-rest-aspect")
    base = Surrogate.open("square-neo-hookean", view="silhouette")
    model = Surrogate.from_database(database, base=base)
    assert model.view == model.fixed(rest_aspect=1.02).view == "silhouette"
    null = {**PLACE, "rest_aspect": np.array([1.0])}
    np.testing.assert_allclose(model(null, outline=True).outline, base(PLACE, outline=True).outline, atol=1e-9)
    assert np.isfinite(model.outline_modes(**POINT, rest_aspect=1.03)).all()
    with pytest.raises(InputError, match='view: expected "silhouette", that of the base'):
        Surrogate.from_database(database, base=base, view="mid-plane")


def test_shipped_silhouettes_are_approximated_as_well_as_mid_plane_outlines():
    """Median and largest root mean square of a case left out, over all branches [l]."""
    database = Database.open("square-neo-hookean")
    cases = database.converged
    scaling = PlaneScaling.of(cases["capillary_number"], cases["size_ratio"])
    errors = {view: [] for view in OUTLINES}
    for branch in branches_of(database):
        smooth = approximation_of(cases, branch, scaling)
        for view, name in OUTLINES.items():
            values = cases[name][branch.rows].reshape(len(branch.rows), -1)
            left_out = leave_one_out(replace(smooth, values=values)) - values
            errors[view].extend(np.sqrt(np.mean(left_out**2, axis=1)))
    mid_plane, silhouette = (np.array(errors[view]) for view in ("mid-plane", "silhouette"))
    assert np.nanmedian(silhouette) < 2.0 * np.nanmedian(mid_plane)
    assert np.nanmax(silhouette) < 1.2 * np.nanmax(mid_plane)
    assert np.nanmedian(silhouette) < 1e-3
