"""check_law lets good laws pass and says which promise a bad one breaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from capsbayes.errors import BrokenPromiseError, CapsbayesError
from capsbayes.physics.membrane import GeneralisedHooke, NeoHookean, Skalak
from capsbayes.testing import check_law


@dataclass(frozen=True)
class Renamed(NeoHookean):
    name = " "


@dataclass(frozen=True)
class WrongModulus(NeoHookean):
    area_dilation_modulus = 1.0


@dataclass(frozen=True)
class YoungModulus(NeoHookean):
    """The same law over E_s = 3 G_s: the convention that makes Ca three times too small."""

    def derivatives(self, i1, i2):
        return tuple(term / 3 for term in super().derivatives(i1, i2))


@dataclass(frozen=True)
class WrongCurvature(NeoHookean):
    def derivatives(self, i1, i2):
        *rest, w22 = super().derivatives(i1, i2)
        return (*rest, 2 * w22)


@dataclass(frozen=True)
class Prestressed(NeoHookean):
    def derivatives(self, i1, i2):
        w, w1, *rest = super().derivatives(i1, i2)
        return (w + 0.1 * i1, w1 + 0.1, *rest)


@dataclass(frozen=True)
class Directed(NeoHookean):
    def principal_tensions(self, stretch):
        return super().principal_tensions(stretch) * np.array([1.0, 1.5])


@dataclass(frozen=True)
class Careless(NeoHookean):
    def derivatives(self, i1, i2):
        i2 += 1e-3
        return super().derivatives(i1, i2)


@dataclass(frozen=True)
class Scalar(NeoHookean):
    def derivatives(self, i1, i2):
        w, *rest = super().derivatives(i1, i2)
        return (w, 0.5, *rest[1:])


@dataclass(frozen=True)
class Raising(NeoHookean):
    def derivatives(self, i1, i2):
        raise ZeroDivisionError("no such strain")


def test_good_laws_pass():
    for law in (NeoHookean(), Skalak(1.0), Skalak(10.0), GeneralisedHooke(0.5)):
        check_law(law)


def test_a_bad_law_is_told_which_promise_it_breaks():
    assert issubclass(BrokenPromiseError, AssertionError)
    assert issubclass(BrokenPromiseError, CapsbayesError)
    for law, promise, found in (
        (Renamed(), "has a name", "name ' '"),
        (WrongModulus(), "area dilation modulus", "K_s/G_s = 3.0000"),
        (YoungModulus(), "shear modulus at small strain is 1", "G_s = 0.333333"),
        (WrongCurvature(), "derivatives are those of its energy", "w22 = "),
        (Prestressed(), "neither energy nor tension", "tension at rest = 0.2"),
        (Directed(), "tau_2 = (1/l1) dW/dl2", "at l1, l2 ="),
        (Careless(), "each point by itself", "writes into its arguments"),
        (Scalar(), "each point by itself", "w1 of shape ()"),
        (Raising(), "each point by itself", "ZeroDivisionError: no such strain"),
    ):
        with pytest.raises(BrokenPromiseError) as caught:
            check_law(law)
        assert promise in caught.value.promise
        assert found in caught.value.found
        assert str(caught.value).startswith(f"{type(law).__name__} breaks its promise: ")
