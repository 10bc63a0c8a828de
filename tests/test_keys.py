"""The table of keys on the site is that of what commands write."""

import runpy
from pathlib import Path

from capsbayes import Experiment, Measurement, Surrogate, identify
from capsbayes.report.files import posterior_summary

ROOT = Path(__file__).parents[1]
KEYS = runpy.run_path(str(ROOT / "docs" / "prepare" / "keys.py"))


def listed(command):
    return [key for function in KEYS["RESULTS"][command] for key in KEYS["keys_of"](function)]


def test_each_key_has_a_meaning_and_each_meaning_a_key():
    keys = {key for command in KEYS["RESULTS"] for key in listed(command)}
    assert keys == set(KEYS["MEANINGS"])
    assert KEYS["keys_table"]().count("| key | meaning |") == len(KEYS["RESULTS"])


def test_the_table_of_identify_lists_what_it_writes():
    capsule = ROOT / "examples" / "ovalbumin" / "capsule.toml"
    experiment = Experiment.read(capsule.with_name("experiment.toml"))
    model = Surrogate.open("square-neo-hookean")
    written = posterior_summary(identify(Measurement.read(capsule), model, experiment, engine="quadrature", seed=1))
    keys = listed("`identify`, also in `summary.json`")
    sometimes = {"surface_shear_modulus_over_laws", "width_over_prior", "sd_of_log_surface_shear_modulus", "refinement"}
    assert set(written) == set(keys) - sometimes
    marginal = {"median", "mean", "sd", "lower_68", "upper_68", "lower_95", "upper_95"}
    assert all(set(found) == marginal | {"symbol", "unit"} for found in written["quantities"].values())
