import numpy as np
import pytest

from capsbayes.infer.checks import Gate, agreement
from capsbayes.infer.prior import Marginal
from capsbayes.infer.sampling import chain_gates, ess_gates
from capsbayes.infer.verdict import leaning


def walk(rng, steps=800, ensembles=4, walkers=32, stay=0.6):
    """Independent draws that each walker keeps for a while: steps, ensembles, walkers, two coordinates."""
    chain = rng.standard_normal((steps, ensembles, walkers, 2))
    kept = rng.uniform(size=(steps, ensembles, walkers)) < stay
    for k in range(1, steps):
        chain[k][kept[k]] = chain[k - 1][kept[k]]
    return chain


def failed(gates):
    return {gate.name for gate in gates if not gate.passed}


def test_a_good_chain_passes_all_gates():
    gates = chain_gates(walk(np.random.default_rng(13)))
    assert failed(gates) == set()
    assert len(gates) == 7


@pytest.mark.parametrize(
    ("spoil", "gate"),
    [
        (lambda chain: chain[:, :3], "independent ensembles"),
        (lambda chain: chain + np.array([0.0, 0.0, 0.0, 0.5])[None, :, None, None], "split R-hat between ensembles"),
        (lambda chain: chain[:60], "steps over autocorrelation time"),
        (lambda chain: np.repeat(chain[:80], 20, axis=0), "lowest acceptance"),
        (lambda chain: np.random.default_rng(14).standard_normal(chain.shape), "highest acceptance"),
    ],
)
def test_each_gate_catches_its_own(spoil, gate):
    gates = chain_gates(spoil(walk(np.random.default_rng(13))))
    assert gate in failed(gates)
    assert any("FAILED" in str(one) for one in gates)


def test_a_walker_that_never_moves_is_seen():
    chain = walk(np.random.default_rng(13))
    chain[:, 1, 5] = 0.0
    assert "stuck walkers" in failed(chain_gates(chain))


def test_a_walker_that_got_stuck_halfway_is_seen():
    chain = walk(np.random.default_rng(13))
    chain[300:, 1, 5] = chain[300, 1, 5]
    assert "stuck walkers" in failed(chain_gates(chain))


def test_too_few_effective_draws_are_seen_and_constants_ignored():
    rng = np.random.default_rng(15)
    few, many = rng.standard_normal((4, 60)), rng.standard_normal((4, 600))
    assert failed(ess_gates({"a": few, "b": np.ones((4, 60))})) == {"smallest bulk ESS", "smallest tail ESS"}
    assert failed(ess_gates({"a": many})) == set()


@pytest.mark.parametrize(("shift", "stretch", "passed"), [(0.0, 1.0, True), (0.2, 1.0, False), (0.0, 0.93, False)])
def test_agreement_is_in_means_and_standard_deviations(shift, stretch, passed):
    normal = np.random.default_rng(16).standard_normal(400_000)
    draws = {"capsule_radius": np.exp(0.1 * (stretch * normal + shift)), "half_width": np.ones(10)}
    reference = {
        "capsule_radius": Marginal(0.0, 0.1, 0.0, -0.0994, 0.0994, -0.196, 0.196),
        "half_width": Marginal.known(0.0),
    }
    found = agreement(draws, reference)
    assert found.passed is passed
    assert found.mean == pytest.approx(shift, abs=0.01)
    assert found.sd == pytest.approx(abs(1.0 - stretch), abs=0.01)
    assert found.worst == "capsule_radius"
    assert ("the engines agree" if passed else "DISAGREE") in str(found)


def test_a_shape_far_away_with_hardly_any_probability_is_no_disagreement():
    """It widens the standard deviation by a tenth and no interval; walkers do not find it."""
    draws = {"capsule_radius": np.exp(0.1 * np.random.default_rng(18).standard_normal(400_000))}
    assert agreement(draws, {"capsule_radius": Marginal(0.0, 0.11, 0.0, -0.0994, 0.0994, -0.196, 0.196)}).passed
    assert not agreement(draws, {"capsule_radius": Marginal(0.0, 0.11, 0.0, -0.1094, 0.1094, -0.2156, 0.2156)}).passed


def test_the_share_of_a_posterior_next_to_a_border():
    draws = {"x": np.exp(0.1 * np.random.default_rng(17).standard_normal(8000))}
    far, near = leaning(draws, ("x",), lambda x: x < 2.0), leaning(draws, ("x",), lambda x: x < np.exp(0.1))
    assert far == 0.0
    assert near == pytest.approx(0.31, abs=0.02)  # beyond half a standard deviation, to one from the mean


@pytest.mark.parametrize(
    ("p_value", "tested", "passed", "said"),
    [
        (0.004, 1, False, ""),
        (0.009, 1, True, "is 0.009. Were the model and the stated errors right, it would be below 0.05 in 5 % of"),
        (0.06, 1, True, ""),
        (0.0024, 2, False, ""),
        (
            0.024,
            2,
            True,
            "it would be below 0.025 in 2.5 % of measurements at most; below 0.0025 the intervals are not",
        ),
        (0.026, 2, True, ""),
    ],
)
def test_a_p_value_is_said_below_a_twentieth_and_refused_below_a_half_per_cent(p_value, tested, passed, said):
    """Of several, the least has these levels."""
    gate = Gate.of_p_value("p-value of a misfit", p_value, tested)
    assert gate.passed is passed
    assert (said in gate.caveat) if said else (gate.caveat == "")
    assert gate.as_dict().get("caveat", "") == gate.caveat
