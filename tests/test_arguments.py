"""A mistake in the call of a public function is one line, and a model may be given by its name."""

import inspect
from pathlib import Path

import numpy as np
import pytest

import capsbayes as cb
from capsbayes.errors import DatabaseError, InputError

SEEN = cb.Measurement(
    axial_extent="2.14 +/- 0.02", axial_length="1.81 +/- 0.02", capsule_velocity="6.20 +/- 0.06 mm/s", source="x"
)
CHANNEL = cb.Experiment(cross_section="square", half_width="25.0 +/- 0.2 um", viscosity="0.85 +/- 0.02 Pa s")
NAME = "square-neo-hookean"


@pytest.fixture(scope="module")
def model():
    return cb.Surrogate.open(NAME)


def test_a_model_is_given_by_its_name(model):
    how = {"engine": "quadrature", "seed": np.int64(1), "error_budget": False}
    named, opened = (cb.identify(SEEN, given, CHANNEL, **how) for given in (NAME, model))
    assert named.model_sha256 == opened.model_sha256
    assert named.marginals == opened.marginals
    with pytest.raises(DatabaseError, match="rubber"):
        cb.identify(SEEN, "rubber", CHANNEL, seed=1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: cb.identify(m, SEEN, CHANNEL, seed=1),
            "identify: measurement: expected a Measurement, got a Surrogate",
        ),
        (
            lambda m: cb.identify("capsule.toml", m, CHANNEL, seed=1),
            "identify: measurement: expected a Measurement, got 'capsule.toml'; "
            "read the file first: Measurement.read('capsule.toml')",
        ),
        (
            lambda m: cb.identify(SEEN, m, CHANNEL, seed=1, prior={"a": 1}),
            "prior: expected a Prior or None, got a dict",
        ),
        (lambda m: cb.identify(SEEN, m, CHANNEL, seed=1.5), "identify: seed: expected a whole number, got 1.5"),
        (lambda m: cb.identify(SEEN, m, CHANNEL, seed=-1), "identify: seed: expected a whole number from 0 on, got -1"),
        (
            lambda m: cb.identify(SEEN, 3, CHANNEL, seed=1),
            'expected a ForwardModel or its name, as "square-neo-hookean", got 3',
        ),
        (lambda m: cb.identify(SEEN, m, Path("e.toml"), seed=1), "read the file first: Experiment.read('e.toml')"),
        (lambda m: cb.identify_folder("x", CHANNEL, m, out="o", seed=1), "identify_folder: model: expected a Forward"),
        (
            lambda m: cb.identify_membrane("x.toml", CHANNEL, seed=1),
            "measurements: expected a sequence of Measurement, got",
        ),
        (
            lambda m: cb.identify_membrane([SEEN, 1], CHANNEL, seed=1),
            "measurements: expected a sequence of Measurement, got",
        ),
        (lambda m: cb.identify(SEEN, cb.Surrogate, CHANNEL, seed=1), "got the class Surrogate"),
        (lambda m: cb.identify(CHANNEL, m, SEEN, seed=1), "measurement: expected a Measurement, got an Experiment"),
        (lambda m: cb.identify_folder([SEEN], m, CHANNEL, out="o.nc", seed=1), "a path or a DataFrame, got one of the"),
        (
            lambda m: cb.identify_folder("", m, CHANNEL, out="o.nc", seed=1),
            "source: expected a path, got an empty text",
        ),
        (lambda m: cb.measure("", CHANNEL), "measure: picture: expected a path, got an empty text"),
        (lambda m: cb.diagnose([SEEN], m, seed=1), "diagnose: session: expected a Session, a Population or a path"),
        (
            lambda m: cb.Measurement.read(["a.toml"]),
            "['a.toml']: expected the path of a file, got one of the type list",
        ),
        (lambda m: cb.Surrogate("square-neo-hookean"), "Surrogate: database: expected a Database, got 'square-neo"),
        (lambda m: cb.Quantity("25 um"), "value: expected a number, got '25 um'; Quantity.of reads texts"),
        (lambda m: cb.measure("x.png", "experiment.toml"), "measure: experiment: expected an Experiment, got"),
        (lambda m: cb.measure_film("x.avi", m), "measure_film: experiment: expected an Experiment, got a Surrogate"),
        (lambda m: cb.diagnose(m, "x.nc", seed="1"), "diagnose: seed: expected a whole number, got '1'"),
        (lambda m: cb.diagnose(CHANNEL, SEEN, seed=1), "diagnose: model: expected a ForwardModel"),
        (lambda m: cb.hierarchy("run.nc", seed=1), "hierarchy: population: expected a Population, got 'run.nc'"),
        (lambda m: cb.error_budget(SEEN), "error_budget: posterior: expected a Posterior, got a Measurement"),
        (
            lambda m: cb.sobol_indices(CHANNEL, m, SEEN, seed=1),
            "sobol_indices: measurement: expected a Measurement, got",
        ),
        (lambda m: cb.identifiability_map(CHANNEL, m, None), "identifiability_map: model: expected a ForwardModel"),
    ],
)
def test_a_mistake_is_one_line(model, call, message):
    with pytest.raises(InputError) as refused:
        call(model)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_wrong_keyword_is_named_with_the_right_ones(model):
    with pytest.raises(TypeError, match=r"identify: got an unexpected keyword argument 'sead'; it takes .*, seed,"):
        cb.identify(SEEN, model, CHANNEL, seed=1, sead=1)
    with pytest.raises(InputError) as refused:
        cb.identify(SEEN, model, CHANNEL, seed=1, membrane="unknown")
    assert str(refused.value).endswith("got 'unknown'")  # which is no file that could be read


def test_every_public_function_checks_its_arguments():
    functions = [getattr(cb, name) for name in cb.__all__ if inspect.isfunction(getattr(cb, name))]
    assert len(functions) == 16
    assert all(function.__code__.co_filename.endswith("arguments.py") for function in functions)
