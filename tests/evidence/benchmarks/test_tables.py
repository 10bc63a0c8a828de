"""The tables of the pages are those of the stored results of the benchmarks, which say what the pages claim."""

import re

import numpy as np
import pytest
from scipy import stats

from capsbayes import Surrogate
from capsbayes.membrane_database import FREE_PARAMETERS, THICK, MembraneDatabase
from capsbayes.report.posterior import BEYOND_LAWS
from capsbayes.surrogate import MembraneSurrogate
from evidence.benchmarks import (
    bending,
    conditions,
    film_silhouettes,
    flow_rates,
    hidden_sessions,
    low_capillary_number,
    membrane,
    membrane_batches,
    membrane_coverage,
    membrane_effects,
    membrane_pools,
    membrane_sensitivity,
    microscope,
    mutation,
    off_axis,
    omitted_effects,
    picture_moduli,
    picture_sessions,
    population_coverage,
    silhouettes,
    speed,
)
from evidence.benchmarks.counts import percent
from evidence.benchmarks.stored import RESULTS, ROOT
from evidence.markdown import between_marks
from evidence.rebuild import MEMBRANES

SESSIONS = (hidden_sessions, picture_sessions)
DOCS = ROOT / "docs"
BENCHMARKS = (
    *(
        bending,
        low_capillary_number,
        conditions,
        film_silhouettes,
        flow_rates,
        hidden_sessions,
        membrane_batches,
        membrane_coverage,
    ),
    *(membrane_effects, membrane_sensitivity, mutation, off_axis, omitted_effects, picture_moduli, picture_sessions),
    *(microscope, population_coverage, silhouettes, speed),
)
STORED = [module.STORED for module in BENCHMARKS] + [membrane_sensitivity.SAME, membrane_sensitivity.MAP]


def stored(module):
    return module.STORED.read()


@pytest.mark.parametrize("benchmark", STORED, ids=lambda benchmark: benchmark.file.stem)
def test_a_page_shows_the_stored_tables_without_nan(benchmark):
    for name, table in benchmark.tables(benchmark.read()).items():
        assert between_marks(name, table) in benchmark.page.read_text()
        assert not {"nan", "inf"} & {*re.findall(r"\w+", table.lower())}


def test_tables_have_every_row():
    assert stored(speed).keys() <= speed.ROWS.keys()
    assert all(row["wall"] > 0.0 < row["processor"] for row in stored(speed).values())
    assert list(stored(conditions)) == list(conditions.CONDITIONS)
    assert {sum(numbers["statuses"].values()) for numbers in stored(conditions).values()} == {100}
    assert list(stored(microscope)) == list(microscope.CONDITIONS)
    assert len({sum(row["statuses"].values()) for row in stored(microscope).values()}) == 1
    assert list(stored(picture_moduli)) == [f"all, {optics}" for optics in picture_moduli.OPTICS] + [
        *picture_moduli.NAMES
    ]
    pictures = [row["pictures"] for row in stored(picture_moduli).values()]
    assert {row["n"] + sum(row["refused"].values()) for row in pictures} == {80, 40 * len(picture_moduli.NAMES)}
    assert sum(row["n"] + len(row["omitted"]) for row in stored(silhouettes).values()) >= 80
    assert len(stored(film_silhouettes)) >= 40
    assert len(stored(off_axis)) == len(off_axis.CAPSULES)
    assert stored(omitted_effects).keys() == {cell.name for cell in omitted_effects.cells()}
    assert {each["row"] for each in stored(flow_rates)} == {row.hidden for row in flow_rates.ROWS}
    assert all(2 * row["capsules"] > row["of"] for row in stored(membrane_effects).values())
    assert all(row.hidden in module.STORED.page.read_text() for module in SESSIONS for row in module.ROWS)
    assert list(stored(mutation)) == list(mutation.ROOMS)


def test_moduli_from_pictures_are_missed_where_the_page_says():
    def missed(way):
        for name, row in stored(picture_moduli).items():
            number = row[way]["n"]
            least = stats.binom.ppf(0.025, number, 0.95)
            if number <= 80 and min(row[way][f"{quantity} 95"] for quantity in picture_moduli.QUANTITIES) < least:
                yield name

    bump, squared = "a smooth bump of 3 px on the rear", "levels squared"
    assert [*missed("silhouette")] == ["halo 15 %", bump, squared]
    assert [*missed("lengths")] == [bump, squared]


def test_lengths_and_moduli_through_a_microscope_are_missed_where_the_page_says():
    missed = {}
    for name, row in stored(microscope).items():
        counts = [(row["L_z"]["inside"]["95%"], row["L_z"]["n"])] if "L_z" in row else []
        counts += [(row["G_s"][f"{microscope.MODULUS} 95"], row["G_s"]["n"])] if row["G_s"]["n"] else []
        if any(held < stats.binom.ppf(0.025, number, 0.95) for held, number in counts):
            missed[name] = [percent(held / number) for held, number in counts]
    page = " ".join(microscope.STORED.page.read_text().split())
    told = re.findall(r"\*([^*]+)\*: (\d+ %) of \$L_z\$, (\d+ %) of G_s", page)
    assert {name: shares for name, *shares in told} == missed


def test_intervals_of_batches_hold_on_every_mesh():
    """The same capsules at refinement 8, 12 and 16, with states of 12."""
    answers = stored(membrane_batches)["meshes"]
    assert len(answers) == 9
    for answer in answers.values():
        for name in ("surface_shear_modulus", "area_dilation_modulus", "strain_hardening"):
            _, low, high, truth = answer[name]
            assert low < truth < high or truth == 0.0  # an end of the range
    page = " ".join(membrane_batches.STORED.page.read_text().split())
    assert f"G_s of all {sum(answer['each 95'] for answer in answers.values())} capsules" in page
    medians = np.reshape([answers[name]["surface_shear_modulus"][0] for name in sorted(answers)], (-1, 3))
    moves = 100.0 * np.abs(medians[:, 2] / medians[:, 0] - 1.0)
    assert f"move by {moves.min():.1f} to {moves.max():.1f} %" in page


def test_the_change_to_the_finest_mesh_is_that_of_the_page():
    pool = membrane_pools.stored("meshes")
    coarse, usual, fine = (pool["profile"][pool["refinement"] == mesh] for mesh in membrane_pools.MESHES)
    places = [pool["values"][pool["refinement"] == mesh] for mesh in membrane_pools.MESHES]
    assert np.array_equal(places[0], places[1])
    assert np.array_equal(places[1], places[2])
    first, second = (np.sqrt(np.mean((b - a) ** 2, axis=(1, 2))) for a, b in ((coarse, usual), (usual, fine)))
    share = f"{np.median(second / first):.2f} of the change from 8 to 12"
    assert share in " ".join(membrane_batches.STORED.page.read_text().split())


def test_a_film_is_hardly_wider_than_its_best_frame():
    """By chance only: in blurred films the frames judge one fringe differently, and the best of six is the boldest."""
    films = [one for one in stored(film_silhouettes).values() if one.get("film")]
    usual = [one["film"][1] / np.median([each[1] for each in one["frames"] if each]) for one in films]
    assert max(usual) < 1.1  # 1.06
    assert np.median(film_silhouettes.ratios(films)) < 0.9
    assert max(film_silhouettes.ratios(films)) < 1.3  # 1.25, of a film blurred by 2 px


def test_intervals_off_the_axis_hold_the_truth_with_the_error_of_place_alone():
    across = [each for rows in stored(off_axis).values() for each in rows if each["view"] == off_axis.VIEWS[0]]
    held = {which: sum(each[which]["held"] for each in across) for which in ("with", "without")}
    assert held["with"] > 0.8 * len(across) > held["without"]


def test_nothing_is_claimed_of_flow_rates_where_nothing_is_hidden_and_no_name_is_wrong():
    answers = stored(flow_rates)
    assert {each["said"] for each in answers if each["row"] == "nothing"} == {"nothing found"}
    assert not [each for each in answers if each["said"] == "wrong"]
    sets = [each["names"] for each in answers if each["kind"] == "outlines" and each["said"] == "in a set"]
    assert 0 < max(map(len, sets)) <= 4


@pytest.mark.parametrize("module", SESSIONS)
def test_no_name_of_a_session_is_wrong(module):
    rows = {row.hidden: row for row in module.ROWS}
    outcomes = [(each["hidden"], hidden_sessions.outcome(rows[each["hidden"]], each)) for each in stored(module)]
    assert outcomes
    assert not {hidden for hidden, outcome in outcomes if "wrong" in outcome}


def test_sizes_that_are_found_in_pictures_are_true():
    sizes = {"pre_inflation": 0.035, "strain_hardening": 0.8, "rest_aspect": 0.925, "section_aspect": 1.075}
    sizes |= {"pixel_aspect": 1.04, "hooke_share": 1.0}
    rows = {row.hidden: row for row in picture_sessions.ROWS}
    named = [answer for answer in stored(picture_sessions) if answer["verdict"] == "NAMED"]
    held = [
        low <= sizes[name] <= high
        for answer in named
        for name, (low, high) in answer["intervals_95"].items()
        if rows[answer["hidden"]].truth == (name,)
    ]
    assert len(held) == len(named)
    assert sum(held) >= len(held) - 1
    assert f"holds the truth in {sum(held)} of {len(held)} named sessions" in picture_sessions.STORED.page.read_text()


@pytest.mark.parametrize("effect", ["pre_inflation", "pixel_scale"])
def test_what_is_stored_of_an_omitted_effect_is_what_is_computed(effect):
    found = stored(omitted_effects)
    cell = next(cell for cell in omitted_effects.cells() if cell.effect == effect)
    again = omitted_effects.omitted(cell, Surrogate.open("square-neo-hookean"))
    assert again == pytest.approx(found[cell.name], rel=0.01, abs=1e-4)
    assert found[cell.name]["log_modulus"] > 0.0


def test_pre_inflation_and_hardening_do_not_add_up():
    for name, row in stored(membrane_effects).items():
        if name == "pre-inflation, strain hardening" or name.startswith(membrane_effects.ALL_FOUR):
            added, together = (row[way] for way in membrane_effects.WAYS)
            assert together["rms"] < 0.4 * added["rms"]
            assert together["score"] < 1.0 < 2.0 < added["score"]
            assert together["gap"] < 0.5 * added["gap"]


def test_batches_tell_what_is_expected():
    found = stored(membrane_sensitivity)
    of_one = membrane_sensitivity.MAP.read()
    assert of_one["model_sha256"] == membrane_coverage.model("unknown").sha256, "the map is of another model"
    expected, told = found["lengths"]["surface_shear_modulus"][:2]
    assert told == pytest.approx(expected, rel=0.1)
    expected, told = found["outline"]["surface_shear_modulus"][:2]
    assert expected < told < 1.6 * expected  # the goal of a tenth is missed, as the page says
    tail = f"{stored(membrane_batches)['tail']:g} of its standard deviations"
    assert tail in membrane_batches.STORED.page.read_text()


@pytest.mark.parametrize("kind", membrane_coverage.KINDS)
def test_intervals_with_the_membrane_unknown_hold_the_truth_as_often_as_they_say(kind):
    counts = stored(membrane_coverage)["capsules"]
    row, default = counts[f"{kind}, unknown"], counts[f"{kind}, neo-Hookean"]
    used = row["capsules"] - row["refused"]
    assert used >= 20
    for quantity in membrane_coverage.QUANTITIES:
        for level in membrane_coverage.LEVELS:
            held = row[f"{quantity} {level}"]
            assert stats.binomtest(held, used, level / 100).pvalue > 1e-3, (quantity, level, held)
    assert default["surface_shear_modulus 95"] < 0.6 * (default["capsules"] - default["refused"])


def test_what_another_law_does_to_the_modulus_is_what_the_answer_says():
    bias = stored(membrane_coverage)["others"]["outline, generalised Hooke"]["bias"]
    assert round(float(np.expm1(bias)), 1) == BEYOND_LAWS


def test_the_errors_of_the_membrane_model_are_those_of_the_page():
    shown = membrane.PAGE.read_text().partition("<!-- errors -->")[2].partition("<!-- end of errors -->")[0]
    pages, now = (
        [[float(cell) for cell in line.split("|")[2:-1]] for line in text.strip().splitlines()[2:]]
        for text in (shown, membrane.errors())
    )
    assert len(pages) == len(now) == 13
    for one, other in zip(pages, now, strict=True):
        assert one == pytest.approx(other, rel=0.15)  # of two digits


def test_the_pages_state_the_errors_of_the_membrane_model_for_fresh_shapes():
    pool = membrane_pools.stored("capsules")
    columns = pool["values"], pool["numbers"][:, :3], pool["profile"]
    values, relative, score, off = membrane.compared(MembraneSurrogate.open("square"), *columns)
    page, guide = (" ".join(file.read_text().split()) for file in (membrane.PAGE, DOCS / "membrane.md"))
    squares = np.sort(off**2)[::-1]
    few = np.searchsorted(np.cumsum(squares), 0.9 * squares.sum()) + 1
    assert f"{few} of the {len(off)} fresh shapes make nine tenths" in page
    beyond = [f"{share:.1%}"[:-1] for share in np.mean(np.abs(score) > 1.96, axis=0)]
    assert f"{beyond[0]}, {beyond[1]} and {beyond[2]} % differ by more than 1.96 standard deviations" in page
    assert f"The largest $z$, {np.abs(score).max():.2g}," in page
    assert f"For {len(off)} capsules at random places" in guide
    assert f"{beyond[0]} % of L_z and {beyond[2]} % of $v_\\mathrm{{o}}/U$" in guide
    finest = membrane.rms(score[pool["refinement"] == membrane_pools.FINE])
    assert f"there the differences are {finest:.1g} of the stated error" in guide
    usual = pool["refinement"] == membrane_pools.USUAL
    rows = [usual & some for some in (values[:, 5] <= THICK, values[:, 5] > THICK)]
    thin, thick = (f"{1e3 * np.median(off[some]):.2g}e-3 l" for some in rows)
    assert f"{thin} for the outline of thin membranes and {thick} for that of thick ones" in guide
    thin, thick = (f"{100.0 * np.median(np.abs(relative[some, 0])):.2g} %" for some in rows)
    assert f"those of L_z are {thin} and {thick}" in guide


def test_the_pages_count_the_states_of_the_membrane():
    guide, data = (" ".join(page.read_text().split()) for page in (DOCS / "membrane.md", ROOT / "data" / "README.md"))
    square, circular = (MembraneDatabase.open(name) for name in ("square", "circular"))
    for name, states in (("square", square), ("circular", circular)):
        recipe, lost = MEMBRANES[f"membrane-{name}"], states.dataset.sizes["lost_state"]
        places = sum(recipe.thin) + sum(recipe.thick)
        first = places - lost
        assert f"{len(states)} states" in data
        assert f"{places} places of that command" in data
        assert f"{lost} places, where" in data or f"{lost} places where" in data
        assert (len(states) > first) == (recipe.needed > 0)
        if recipe.needed:
            assert f"{first} of these are of the first" in data
            assert f"The last {len(states) - first} are of {recipe.needed} further places" in data
            assert f"{len(states) - first} further states lie" in guide
            assert f"of {recipe.needed} such places" in guide
            assert f"over the first {first} states" in guide


def test_the_page_says_how_the_states_that_were_needed_differ_from_what_was_said_of_them():
    """They are the last of the file; the model is that of the others."""
    square, recipe = MembraneDatabase.open("square"), MEMBRANES["membrane-square"]
    first = sum(recipe.thin) + sum(recipe.thick) - square.dataset.sizes["lost_state"]
    values, numbers = square["values"][first:], square["numbers"][first:, :3]
    said = MembraneSurrogate(square.taken(np.arange(first)))(dict(zip(FREE_PARAMETERS, values.T, strict=True)))
    shown = np.stack([said.axial_extent, said.axial_length, said.velocity_ratio], axis=1)
    scores = np.abs(numbers - shown) / np.sqrt(np.diagonal(said.covariance, axis1=1, axis2=2))
    median, most, largest = np.quantile(scores.max(axis=1), [0.5, 0.95, 1.0])
    page = " ".join(membrane.PAGE.read_text().split())
    assert f"The last {len(values)} states were simulated where the model of the first {first}" in page
    assert f"errs by {median:.1f} of its standard deviations" in page
    assert f"by more than {most:.1f} for one in twenty, and by {largest:.1f} for one" in page


def test_the_page_of_evidence_counts_the_mutants_the_targets_of_times_and_of_the_verification():
    page, done = (DOCS / "evidence.md").read_text(), stored(mutation)
    ends = [sum(len(entry[end]) for of in done.values() for entry in of.values()) for end in ("killed", "alive")]
    assert f"{ends[0]} of {sum(ends)} mistakes" in page
    wanted = {name: speed.ROWS[name].wanted for name in stored(speed) if speed.ROWS[name].wanted}
    missed = sum(stored(speed)[name]["wall"] > most for name, most in wanted.items())
    assert f"Of the {len(wanted)} times that were wanted {missed} are missed" in page
    verification = (RESULTS / "verification" / "verification.md").read_text()
    topics = re.findall(r"^\| \[.*?\| (\d+) \| (\d+) \| 0 \|", verification, re.M)
    met, missed = (sum(map(int, column)) for column in zip(*topics, strict=True))
    assert f"{met} of {met + missed} targets met" in page


def test_the_guides_state_the_stored_counts():
    counts, batches = stored(membrane_coverage), stored(membrane_batches)["coverage"]
    guide, limits = (" ".join((DOCS / page).read_text().split()) for page in ("membrane.md", "limits.md"))

    def used(row):
        return row["capsules"] - row["refused"]

    def share(row, quantity="surface_shear_modulus"):
        return f"{row[f'{quantity} 95'] / used(row):.1%}".replace("%", " %")

    one = counts["capsules"]
    lengths, outline = (one[f"{kind}, unknown"] for kind in ("lengths", "outline"))
    assert f"for {share(lengths)} of {used(lengths)} capsules measured by lengths" in guide
    assert f"and {share(outline)} of {used(outline)} measured by outlines" in guide
    others = [share(row, name) for row in (lengths, outline) for name in list(membrane_coverage.QUANTITIES)[1:]]
    assert f"for {min(others).removesuffix(' %')} to {max(others)}" in guide
    page = " ".join(membrane_coverage.STORED.page.read_text().split())
    missed = set()
    for kind, row in (("lengths", lengths), ("outline", outline)):
        for name in (f"{quantity} {level}" for quantity in membrane_coverage.QUANTITIES for level in (68, 95)):
            ends = stats.binomtest(row[name], used(row)).proportion_ci()
            if ends.high < int(name[-2:]) / 100:
                missed.add((kind, name))
                assert f"{row[name]} of {used(row)}" in page
                assert f"{100 * ends.low:.1f} to {100 * ends.high:.1f} %" in page
    of_lengths = ("lengths", "area_dilation_modulus 68")
    assert missed == {of_lengths, ("outline", "area_dilation_modulus 95")}
    for level in membrane_coverage.LEVELS:
        held = sum(
            row[f"{quantity} {level}"] for row in (lengths, outline) for quantity in membrane_coverage.QUANTITIES
        )
        whole = sum(used(row) for row in (lengths, outline)) * len(membrane_coverage.QUANTITIES)
        assert f"{level} % intervals" in page
        assert f"{held / whole:.1%}".replace("%", " %") in page
    fine = [one[f"{kind}, {membrane_coverage.FINE}"] for kind in ("lengths", "outline")]
    assert [used(row) for row in fine] == [row["surface_shear_modulus 95"] for row in fine] == [20, 20]
    assert min(row[f"{name} 95"] for row in fine for name in membrane_coverage.QUANTITIES) == 17
    lengths, outline = (one[f"{kind}, neo-Hookean"] for kind in ("lengths", "outline"))
    assert f"hold the truth for {share(lengths)} (lengths)" in guide
    assert f"for {outline['refused']} of {outline['capsules']} capsules, which are refused" in guide
    assert f"lengths for {lengths['refused']} of {lengths['capsules']}" in guide
    hooke, other, rubber, ogden = (counts["others"][f"outline, {law}"] for law in membrane_pools.OTHER_LAWS)
    assert f"for {share(rubber)} and {share(ogden)} of those".replace(".0", "") in guide
    assert f"for {share(rubber)} of 20 of Mooney and Rivlin and for {share(ogden)} of 20".replace(".0", "") in limits
    for each in (guide, limits):
        assert f"for {share(hooke).replace('.0', '')} of {used(hooke)} Hooke capsules" in each
        assert f"for {share(other).replace('.0', '')} of {used(other)} of Evans and Skalak" in each
        of_all = batches["outline, unknown"]
        assert f"in {of_all['surface_shear_modulus 95']} of {of_all['surface_shear_modulus']} batches" in each
    of_lengths = batches["lengths, unknown"]
    assert f"in {of_lengths['surface_shear_modulus 95']} of {of_lengths['batches']} measured by lengths" in guide
    assert f"deviation of ln G_s is {of_all['log_modulus_sd']:.2g}" in guide
    one = of_all["surface_shear_modulus_each 95"] / of_all["surface_shear_modulus_each"]
    assert f"of single capsules for {one:.1%}".replace("%", " %") in guide
    missed = set()
    for kind in ("outline", "lengths"):
        row = batches[f"{kind}, unknown"]
        for name in (f"{quantity} {level}" for quantity in membrane_batches.QUANTITIES for level in (68, 95)):
            of = row[name[:-3]]
            ends = stats.binomtest(row[name], of).proportion_ci()
            if ends.high < int(name[-2:]) / 100:
                missed.add((kind, name))
                assert f"{row[name]} of {of}" in page
    each = "surface_shear_modulus_each"
    assert missed == {("outline", f"{each} 95")}
    alpha = of_all["pre_inflation 95"], of_all["pre_inflation"]
    assert "that of $\\alpha$ in {} of {}".format(*alpha) in guide
    plain = [batches[f"{kind}, neo-Hookean"] for kind in ("outline", "lengths")]
    assert [(row["not to be used"], row["batches"]) for row in plain] == [(40, 40), (39, 40)]
    assert "fail for all 40 batches of outlines and for 39 of lengths" in page
    assert "law one of these 80 passes" in guide


def test_the_page_counts_the_batches_whose_inflation_varies():
    batches = stored(membrane_batches)["inflated"].values()

    def held(quantity):
        intervals = (batch[quantity] for batch in batches)
        return sum(low <= truth <= high for _, low, high, truth in intervals)

    modulus, alpha, spread, modulus_of_one, alpha_of_one = map(
        held,
        (
            *("varying surface_shear_modulus", "varying pre_inflation", "varying inflation_spread"),
            *("one surface_shear_modulus", "one pre_inflation"),
        ),
    )
    page = " ".join(membrane_batches.STORED.page.read_text().split())
    assert modulus == spread
    assert f"hold the truth in {modulus} of {len(batches)}, those of the median of $\\alpha$ in {alpha}." in page
    assert f"those of G_s hold it in {modulus_of_one}, those of $\\alpha$ in {alpha_of_one}." in page


def test_the_guide_to_planning_states_what_one_capsule_tells():
    guide = " ".join((DOCS / "planning.md").read_text().split())
    same, of_one = membrane_sensitivity.SAME.read(), membrane_sensitivity.MAP.read()
    for kind, words in (("lengths", "with lengths"), ("outline", "with outlines")):
        first, last = (same[kind][flows]["surface_shear_modulus"] for flows in ("1", "4"))
        assert f"from {first:.2g} to {last:.2g} {words}" in guide
    assert f"median standard deviation {of_one['quantiles']['unknown_lengths']['median']:.2g}" in guide
