"""The package is light to import, and its public names are where they should be."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import capsbayes
import capsbayes as cb

EXAMPLE = Path(__file__).parents[1] / "examples" / "ovalbumin"
HEAVY = {"arviz", "cv2", "dask", "distributed", "emcee", "matplotlib", "numba", "scipy", "xarray"}


def modules_after(statement):
    code = f"import sys; {statement}; print(*{{name.split('.')[0] for name in sys.modules}})"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


def test_importing_loads_nothing_heavy_and_no_more_than_is_needed():
    assert not modules_after("import capsbayes, capsbayes.cli") & HEAVY
    assert not modules_after("import capsbayes.database") & {"dask", "matplotlib"}
    assert not modules_after("import capsbayes.infer") & {"cv2", "dask", "distributed", "matplotlib"}


def test_every_public_name_can_be_had():
    for name in capsbayes.__all__:
        assert getattr(capsbayes, name) is not None
        assert name in dir(capsbayes)
    with pytest.raises(AttributeError, match="module 'capsbayes' has no attribute 'capsule'"):
        _ = capsbayes.capsule


def test_no_two_classes_have_one_name():
    sources = (path.read_text(encoding="utf-8") for path in Path(capsbayes.__file__).parent.rglob("*.py"))
    names = Counter(name for text in sources for name in re.findall(r"^class (\w+)", text, flags=re.MULTILINE))
    assert [name for name, count in names.items() if count > 1] == []


def test_the_lines_of_the_design_run(tmp_path):
    experiment = cb.Experiment.read(EXAMPLE / "experiment.toml")
    measurement = cb.Measurement.read(EXAMPLE / "capsule.toml")
    prior = cb.Prior(surface_shear_modulus="log-uniform 1 .. 1000 mN/m")
    posterior = cb.identify(measurement, cb.Surrogate.open("square-neo-hookean"), experiment, prior=prior, seed=1)
    assert posterior.status.ok
    assert "surface_shear_modulus" in posterior.summary().index
    assert "surface_shear_modulus" in posterior._repr_html_()
    cb.write_report(posterior, tmp_path / "capsule.html")
    found = cb.surrogate.inverse(cb.Database.open("square-neo-hookean"))(axial_extent=2.14, axial_length=1.81)
    assert (found.capillary_number, found.size_ratio) == pytest.approx((0.082, 0.96), rel=0.01)
    assert "bending" in cb.effects.catalogue()
    cb.testing.check_law(cb.NeoHookean())


def test_the_lines_of_the_design_on_many_capsules_run(tmp_path):
    model, batch = cb.Surrogate.open("square-neo-hookean"), EXAMPLE.with_name("batch")
    experiment = cb.Experiment.read(batch / "experiment.toml")
    population = cb.identify_folder(
        batch / "capsules.csv", model, experiment, out=tmp_path / "run.nc", check=0.0, seed=1
    )
    candidates = {name: cb.effects.catalogue()[name] for name in ("halo", "pixel_scale")}
    study = cb.diagnose(population, model, candidates=candidates, seed=1)
    assert len(study.session) + len(study.session.left_out) == len(population)
    assert (study.name, study.model.name) == ("none", model.name)
    assert study.finding.p_value > 0.05
    assert np.isnan(study.gap).all()
    cb.write_report(study, tmp_path / "study.html")
