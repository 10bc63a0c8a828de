"""Six drawn events of one shear modulus in one flow: each has its own velocity, and all have the flow rate."""

import re
from pathlib import Path

import numpy as np
import pytest

from capsbayes.experiment import AREAS, Experiment
from capsbayes.image.rtdc import measure_rtdc
from capsbayes.infer import identify
from capsbayes.surrogate import Surrogate
from evidence.benchmarks.camera import Camera, Capsule, View, photograph

h5py = pytest.importorskip("h5py")
pytest.importorskip("hdf5plugin")

MODULUS, FLOW, VISCOSITY, HALF_WIDTH, PIXEL = 50e-3, 3.75e-3, 0.80, 25e-6, 0.68e-6
RADII = np.array([18.0, 19.0, 20.0, 21.0, 22.0, 23.0]) * 1e-6
SHAPE = (96, 224)
LAB = Experiment("square", "25.0 +/- 0.2 um", "0.80 +/- 0.02 Pa s")
RATE = 1e9 * FLOW * AREAS["square"] * HALF_WIDTH**2  # uL/s
HOW = {"pixel_size": "0.680 +/- 0.003 um", "flow": "right"}


@pytest.fixture(scope="module")
def events(tmp_path_factory):
    """Return the file of the events, and the velocity of each."""
    theta = {"capillary_number": VISCOSITY * FLOW / MODULUS, "outline": True}
    pictures, masks, velocities = [], [], []
    for number, radius in enumerate(RADII):
        shapes = [
            Surrogate.open("square-neo-hookean", view=view).at(**theta, size_ratio=radius / HALF_WIDTH)
            for view in ("mid-plane", "silhouette")
        ]
        centre = 43.0 + 27.0 * number, 0.5 * (SHAPE[0] - 1.0)
        view = View((Capsule(shapes[0].outline[0], shapes[1].outline[0], centre),), HALF_WIDTH / PIXEL, SHAPE)
        pictures.append(photograph(view, Camera(photons=20_000.0), seed=number)[0])
        filled = view.placed(view.capsules[0].silhouette, view.capsules[0])
        masks.append(_inside(filled))
        velocities.append(FLOW * float(shapes[0].velocity_ratio[0]))
    path = tmp_path_factory.mktemp("events") / "six.rtdc"
    with h5py.File(path, "w") as file:
        file.attrs["imaging:pixel size"], file.attrs["setup:channel width"] = 1e6 * PIXEL, 2e6 * HALF_WIDTH
        file.attrs["setup:flow rate"] = RATE
        file["events/image"], file["events/mask"] = np.stack(pictures), np.stack(masks)
    return path, np.array(velocities)


def _inside(corners):
    import cv2

    return cv2.fillPoly(np.zeros(SHAPE, np.uint8), [np.rint(corners).astype(np.int32)], 255)


def answers(path, numbers=range(6), **speeds):
    """Return lower end, median and upper end of the 95 % intervals of G_s [N/m] : (n, 3) array."""
    model, found = Surrogate.open("square-neo-hookean", view="silhouette"), []
    for event in measure_rtdc(path, LAB, **HOW, **speeds, events=numbers):
        posterior = identify(event.measurement, model, LAB, seed=1, engine="quadrature", error_budget=False)
        assert posterior.status.ok
        modulus = posterior.marginals["surface_shear_modulus"]
        found.append((modulus.lower_95, modulus.median, modulus.upper_95))
    return np.array(found)


def trend(medians, numbers=range(6)):
    """Return d ln G_s / d ln a."""
    return float(np.polyfit(np.log(RADII[numbers]), np.log(medians), 1)[0])


def test_the_flow_rate_gives_all_events_their_modulus_without_a_trend(events):
    path, velocities = events
    assert velocities.max() / velocities.min() > 1.05  # small capsules are faster
    low, middle, high = answers(path, flow_rate=f"{RATE!r} +/- {0.01 * RATE!r} uL/s").T
    assert np.all((low < MODULUS) & (high > MODULUS))
    np.testing.assert_allclose(middle, MODULUS, rtol=0.1)
    assert np.max((high - low) / middle) < 0.3
    assert abs(trend(middle)) < 0.2


def test_the_velocity_of_one_event_gives_the_others_another_modulus(events):
    """What one velocity for all makes of the smallest and the largest, and what its stated spread makes of it."""
    path, velocities = events
    ends = [0, 5]
    wrong = answers(path, ends, shared_velocity=f"{1e3 * velocities[-1]:.4f} +/- 0.01 mm/s")
    assert trend(wrong[:, 1], ends) > 0.5
    mean, spread = 1e3 * velocities.mean(), 1e3 * velocities.std(ddof=1)
    low, _, high = answers(path, ends, shared_velocity=f"{mean:.4f} +/- {spread:.4f} mm/s").T
    assert np.all((low < MODULUS) & (high > MODULUS))


def test_the_answer_on_the_page_is_the_truth():
    """That the page prints what the commands print is tested with the page."""
    page, truth = Path("docs/measuring.md").read_text(), Path("examples/pictures/truth.toml").read_text()
    section = page.partition("## .rtdc files")[2]
    wanted = float(re.search(r'surface_shear_modulus = "(\S+) mN/m"', truth)[1])
    median, low, high = map(float, re.search(r"Median G_s = (\S+) mN/m.* from (\S+) to (\S+) mN/m", section).groups())
    interval = 0.01 * float(re.search(r"single capsule is typically ± (\d+) %", section)[1])
    assert interval < 0.15
    assert np.all(np.abs(np.array([median, low, high]) / wanted - 1.0) < 0.6 * interval)
