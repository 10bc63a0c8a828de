"""The mixture of the neo-Hookean law with generalised Hooke's."""

import pytest

from capsbayes.errors import InputError
from capsbayes.physics.membrane import GeneralisedHooke, HookeShare, NeoHookean


@pytest.mark.parametrize(("share", "law"), [(0.0, NeoHookean()), (1.0, GeneralisedHooke(0.5))])
def test_at_its_ends_it_is_one_of_the_two_laws(share, law):
    mixture, stretch = HookeShare(share), [[1.4, 0.9], [0.8, 1.1]]
    assert mixture.name == law.name
    assert mixture.principal_tensions(stretch) == pytest.approx(law.principal_tensions(stretch))


def test_between_them_it_says_the_share():
    assert HookeShare(0.25).name == "neo-Hookean with a share 0.25 of generalised Hooke nu_s = 0.5"
    with pytest.raises(InputError, match=r"hooke_share: expected a number from 0 to 1, got 1\.5$"):
        HookeShare(1.5)
