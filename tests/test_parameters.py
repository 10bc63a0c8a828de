import pytest

from capsbayes.parameters import PARAMETERS


def test_every_quantity_is_listed_under_its_own_name():
    assert all(name == one.name for name, one in PARAMETERS.items())
    assert len({one.symbol for one in PARAMETERS.values()}) == len(PARAMETERS)


def test_units_people_read_scale_from_si():
    assert PARAMETERS["surface_shear_modulus"].shown(0.05) == pytest.approx(50.0)
    assert PARAMETERS["surface_shear_modulus"].label == "G_s [mN/m]"
    assert PARAMETERS["capsule_radius"].axis_label == "$a$ [µm]"
    assert PARAMETERS["capillary_number"].label == "Ca"


def test_the_table_cannot_be_changed():
    with pytest.raises(TypeError):
        PARAMETERS["capsule_radius"] = None
