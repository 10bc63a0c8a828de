from types import MappingProxyType

import numpy as np
import pytest

from capsbayes.errors import BrokenPromiseError, InputError
from capsbayes.model import CoordinateRange, Domain, ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.testing import check_model


class Box(Domain):
    bounds = ((0.01, 0.1), (0.7, 1.1))

    def contains(self, capillary_number, size_ratio, *coordinates):
        (ca_min, ca_max), (size_min, size_max) = self.bounds
        ca, size = np.asarray(capillary_number), np.asarray(size_ratio)
        return (ca >= ca_min) & (ca <= ca_max) & (size >= size_min) & (size <= size_max)


class Sphere(ForwardModel):
    """The rigid limit: every length is the diameter."""

    name, sha256, domain = "sphere", "0" * 64, Box()

    def __call__(self, theta, *, outline=False):
        self.check_names(theta)
        size = np.asarray(theta["size_ratio"])
        inside = self.domain.contains(theta["capillary_number"], size)
        length = np.where(inside, 2 * size, np.nan)
        one = np.where(inside, 1.0, np.nan)
        return Prediction(length, length, one, one, np.zeros((len(size), 3, 3)), inside)


def test_a_model_that_keeps_the_promises_passes():
    check_model(Sphere())
    assert not isinstance(Box(), ForwardModel)
    assert (Sphere().cross_section, Sphere().view, Sphere().database) == (None, "mid-plane", None)
    assert (dict(Sphere().coordinates), Sphere().effects, Sphere().circumstances) == ({}, (), ())
    assert Sphere().names == ("capillary_number", "size_ratio")
    assert Sphere().outline_modes(capillary_number=0.05, size_ratio=0.9) is None
    assert Sphere().caveats({}) == {}
    theta = {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9]), "pre_inflaton": np.array([0.01])}
    with pytest.raises(InputError, match="theta: expected names among capillary_number, size_ratio, got 'pre_inf"):
        Sphere()(theta)
    prediction = Sphere()({"capillary_number": np.array([0.05, 0.5]), "size_ratio": np.array([0.9, 0.9])})
    np.testing.assert_array_equal(prediction.inside, [True, False])
    np.testing.assert_allclose(prediction.axial_extent, [1.8, np.nan])


class Careless(Sphere):
    def check_names(self, given):
        pass


class Nameless(Sphere):
    name = ""


class Sideways(Sphere):
    view = "shadow"


class Shifted(Sphere):
    coordinates = MappingProxyType({"pre_inflation": CoordinateRange(0.01, 0.1, 0.0)})


class Endless(Sphere):
    def __call__(self, theta, *, outline=False):
        found = super().__call__(theta)
        return Prediction(
            *(np.nan_to_num(x) for x in (found.values.T[0], *found.values.T[1:], found.stretch_ratio)),
            found.covariance,
            np.ones(len(found), dtype=bool),
        )


class Narrower(Sphere):
    def __call__(self, theta, *, outline=False):
        found = super().__call__(theta)
        hidden = np.where(np.arange(len(found)) % 2, np.nan, 1.0)
        rows = [values * hidden for values in (*found.values.T, found.stretch_ratio)]
        return Prediction(*rows, found.covariance, found.inside & np.isfinite(hidden))


class Contradictory(Sphere):
    def caveats(self, theta):
        return {"wrinkles": np.array([True])}


def test_the_broken_promise_is_named():
    for model, promise in (
        (Box(), "does not derive from capsbayes.model.ForwardModel"),
        (Nameless(), "name is '', not a text"),
        (Sideways(), "view is 'shadow'"),
        (Shifted(), "null value of pre_inflation is not within its range"),
        (Careless(), "no_such_parameter is ignored"),
        (Endless(), "outside the domain of the model is not NaN"),
        (Narrower(), "it treats each capsule by itself"),
        (Contradictory(), "caveats have the shapes"),
    ):
        with pytest.raises(BrokenPromiseError, match=promise):
            check_model(model)
