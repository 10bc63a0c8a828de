"""What holds for every law of the library."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsbayes.membrane import LAWS
from capsbayes.testing import check_law

every_law = pytest.mark.parametrize("law", [law() for law in LAWS.values()], ids=LAWS)


@every_law
def test_keeps_every_promise(law):
    check_law(law)


@every_law
@given(st.floats(0.7, 1.4), st.floats(0.7, 1.4))
def test_strain_costs_energy(law, l1, l2):
    energy = law.energy(l1**2 + l2**2 - 2, (l1 * l2) ** 2 - 1)
    strain = (l1 - 1) ** 2 + (l2 - 1) ** 2
    assert energy >= 0.1 * strain - 1e-12


@every_law
@given(st.floats(0.7, 1.4), st.floats(0.7, 1.4))
def test_larger_tension_lies_along_the_larger_stretch(law, l1, l2):
    tension = law.principal_tensions(np.array([l1, l2]))
    assert (tension[0] - tension[1]) * (l1 - l2) >= -1e-14
