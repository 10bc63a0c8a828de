"""The mixture of the neo-Hookean law with one that hardens."""

from capsbayes.physics.membrane import NeoHookean, StrainHardening


def test_without_hardening_it_has_the_name_of_the_neo_hookean_law():
    assert StrainHardening(0.0).name == NeoHookean().name
    assert StrainHardening(0.25).name == f"{NeoHookean().name} with strain hardening h = 0.25"
