import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from capsbayes import Simulator
from capsbayes.physics.stokes import WallDiscretisation
from capsbayes.report.simulation import transient_figure


@pytest.fixture(scope="module", params=["square", "circular"])
def moment(request):
    walls = WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5)
    simulator = Simulator(refinement=4, cross_section=request.param, walls=walls)
    return next(simulator.transient(capillary_number=0.1, size_ratio=0.8, until=1.0))


def collections(figure):
    figure.draw_without_rendering()
    channel, membrane = (child for child in figure.axes[0].get_children() if isinstance(child, PolyCollection))
    return channel, membrane


def test_every_moment_has_a_view_with_its_time(moment):
    figure = transient_figure([moment] * 3)
    assert [ax.get_title() for ax in figure.axes] == [rf"({letter})   $Ut/\ell = 0$" for letter in "abc"]
    assert figure.axes[0].texts[-1].get_text() == r"$L_z/\ell = 1.60$,   $V/U = " + f"{moment.velocity_ratio:.2f}$"


def test_a_sphere_looks_round_lit_from_above_and_half_of_the_walls_is_behind_it(moment):
    channel, membrane = collections(transient_figure([moment]))
    centres = np.array([path.vertices[:3].mean(axis=0) for path in membrane.get_paths()])
    assert np.hypot(*centres.T).max() == pytest.approx(0.8, rel=0.01)
    brightness = membrane.get_facecolor()[:, :3].sum(axis=1)
    assert brightness[centres[:, 1] > 0.4].mean() > 1.3 * brightness[centres[:, 1] < -0.4].mean()
    pieces = 8 * len(moment.channel.outline(0.005, 0.0)[0])
    assert len(channel.get_paths()) == pieces / 2
    assert channel.get_zorder() < membrane.get_zorder()
