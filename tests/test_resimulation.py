"""A posterior is checked by the simulator, and corrected for what its model is off."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from polynomial_model import PolynomialModel

from capsbayes import Database, Experiment, Measurement, Posterior, Quantity, Surrogate, identify, resimulate
from capsbayes.errors import InputError
from capsbayes.physics.load import parameters_of
from capsbayes.prediction import NUMBERS
from capsbayes.report import write_report
from capsbayes.report.posterior import resimulation_words
from capsbayes.resimulation import ShapeSource, SimulatedShapes, simulator_of
from capsbayes.status import Status

TRUTH = PolynomialModel()
EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))
CAPSULE = Measurement(
    axial_extent=2.14,
    axial_extent_error=0.01,
    axial_length=1.81,
    axial_length_error=0.01,
    capsule_velocity=5e-3,
    capsule_velocity_error=5e-5,
)
MODULUS = "surface_shear_modulus"


@dataclass(frozen=True)
class OffModel(PolynomialModel):
    """Its rear is too deep, the more the higher Ca; it states an error that is too large."""

    error: float = 0.03
    off: float = 0.03
    sha256: str = "1" * 64

    def __call__(self, theta, *, outline=False):
        seen = super().__call__(theta, outline=outline)
        deeper = self.off * (1.0 + 0.5 * np.log(theta["capillary_number"] / 0.082))
        outlines = seen.outline
        if outlines is not None:
            rear = np.exp(-(((np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False) - np.pi) / 0.5) ** 2))
            outlines = outlines + deeper[:, None, None] * np.stack([rear, 0.0 * rear], axis=-1)
        return replace(seen, axial_length=seen.axial_length - deeper, outline=outlines)

    def outline_modes(self, **theta):
        return np.full((1, 256), self.error)


@dataclass(frozen=True)
class Source:
    """The manufactured model in the place of the simulator, which finds no shape where it is told so."""

    lost: int = 0
    refinement: int = 12
    asked: list = field(default_factory=list)

    def shapes(self, theta, near, folder):
        self.asked.append(len(theta["size_ratio"]))
        found = {name: values[self.lost :] for name, values in theta.items()}
        seen = TRUTH(found, outline=True)
        return SimulatedShapes(found, np.column_stack([getattr(seen, name) for name in NUMBERS]), seen.outline)


@pytest.fixture
def simulated(monkeypatch):
    """A function that lets a source take the place of the simulator."""

    def place(source):
        monkeypatch.setattr(ShapeSource, "of", lambda model: source)
        return source

    return place


def identified(model, capsule=CAPSULE):
    return identify(capsule, model, EXPERIMENT, engine="quadrature", seed=3)


def test_the_modulus_of_a_model_with_a_known_error_is_restored(simulated, tmp_path):
    source, off, right = simulated(Source()), identified(OffModel()), identified(TRUTH)
    known, before = right.marginals[MODULUS], off.marginals[MODULUS]
    assert abs(before.median / known.median - 1.0) > 0.03  # or nothing is to be restored
    found = resimulate(off, OffModel(), 20, folder=tmp_path)
    after = found.marginals[MODULUS]
    assert after.median == pytest.approx(known.median, rel=0.01)
    assert after.ends(95) == pytest.approx(known.ends(95), rel=0.03)
    assert (found.status, set(source.asked)) == (Status.DONE, {20})
    assert found.resimulation.before == before
    assert found.shares["surrogate"] < 0.5 * off.shares["surrogate"]


def test_what_the_simulator_says_comes_back_from_the_file_and_is_written(simulated, tmp_path):
    source, off = simulated(Source()), identified(OffModel())
    found = resimulate(off, OffModel(), 8, folder=tmp_path)
    count = sum(source.asked)
    again = Posterior.read(found.write(tmp_path / "posterior.nc"))
    assert again.as_dict() == found.as_dict()
    np.testing.assert_array_equal(again.resimulation.outlines, found.resimulation.outlines)
    table = found.as_dict()["resimulation"]
    length = table["simulated_minus_predicted"]["axial_length"]
    assert (table["shapes"], table["lost"], table["refinement"]) == (count, 0, 12)
    assert length["mean"] == pytest.approx(0.03, abs=0.005)
    assert length["rms_in_standard_errors"] == pytest.approx(1.0, abs=0.2)
    assert table["surface_shear_modulus_moved"] == found.marginals[MODULUS].median / off.marginals[MODULUS].median - 1.0
    moved = f"{100.0 * table['surface_shear_modulus_moved']:+.2g} %"
    words = f"Checked by the simulator: {count} shapes at refinement 12; the model's error moved G_s by {moved}."
    assert resimulation_words(again).startswith(words)
    assert resimulation_words(off).startswith("Not checked by the simulator")
    page = write_report(again, tmp_path / "page.html").read_text()
    assert f"Checked by the simulator: {count} shapes" in page
    assert "<h2>Checked by the simulator</h2>" in page
    page = write_report(off, tmp_path / "page.html").read_text()
    assert "Not checked by the simulator" in page
    assert "<h2>Checked by the simulator</h2>" not in page
    with pytest.raises(InputError, match="one that the simulator corrected"):
        found.to_inference_data(OffModel())


def test_more_shapes_follow_where_the_posterior_goes_far(simulated, tmp_path):
    """The model is off by many standard deviations of the posterior."""
    far, source = OffModel(error=0.002, off=0.12), simulated(Source())
    sharp = replace(CAPSULE, axial_extent_error=0.003, axial_length_error=0.003)
    found = resimulate(identified(far, sharp), far, 20, folder=tmp_path)
    assert source.asked in ([20, 20], [20, 20, 20])
    assert found.status is Status.DONE
    assert found.marginals[MODULUS].median == pytest.approx(
        identified(TRUTH, sharp).marginals[MODULUS].median, rel=0.01
    )


def test_lost_shapes_forbid_the_intervals(simulated, tmp_path):
    source = simulated(Source(lost=6))
    found = resimulate(identified(OffModel()), OffModel(), 20, folder=tmp_path)
    assert found.status is Status.NOT_RESIMULATED
    assert found.resimulation.lost == 6 * len(source.asked)
    assert "more were not found)" in resimulation_words(found)


@pytest.mark.parametrize("name", [name for name in Database.shipped() if "unsteadiness" not in name])
def test_the_simulator_of_a_shipped_database_has_its_law_and_its_parameter(name):
    database = Database.open(name)
    parameters = (database.effect,) if database.effect != "none" else ()
    made = simulator_of(database.settings, parameters)
    assert made.law.name == database.settings["law"]
    assert made.refinement == max(12, database.settings["refinement"])
    known = {key: value for key, value in database.settings.items() if key not in ("refinement", "unsteadiness")}
    assert {key: made.settings[key] for key in known} == known
    assert set(parameters) <= parameters_of(made).keys()


def test_parameters_that_the_simulator_does_not_follow_are_refused(tmp_path):
    off = identified(OffModel())
    with pytest.raises(InputError, match="a model on a database of simulated shapes"):
        resimulate(off, OffModel(), 20, folder=tmp_path)
    with pytest.raises(InputError, match="from 5 to 1000 shapes, got 4"):
        resimulate(off, OffModel(), 4, folder=tmp_path)
    with pytest.raises(InputError, match=r"expected parameters that the simulator follows, as .*, got corner_radius"):
        ShapeSource.of(Surrogate.open("square-corner-radius"))
    fixed = Surrogate.open("square-corner-radius").fixed(corner_radius=0.1)
    assert ShapeSource.of(fixed).continuation.simulator.corner_radius == 0.1


@pytest.mark.slow
def test_the_shipped_model_agrees_with_the_simulator(tmp_path):
    model = Surrogate.open("square-neo-hookean")
    before = identified(model)
    found = resimulate(before, model, 5, folder=tmp_path)
    assert found.status is Status.DONE
    assert abs(found.resimulation.moved(found.marginals[MODULUS])) < 0.005
    assert np.abs(found.resimulation.differences).max() < 1e-3
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.part")}
    resimulate(before, model, 5, folder=tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.part")} == kept
