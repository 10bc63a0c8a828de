"""Take the keys of what commands print with ``--json``, and write into files, from the functions that make them."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from capsbayes import Hierarchy, Posterior, SharedMembrane, SteadyState
from capsbayes.cli.many_capsules import batch_summary
from capsbayes.diagnosis.diagnosis import summary
from capsbayes.plan.budget import ErrorBudget
from capsbayes.plan.flow import FlowDesign
from capsbayes.plan.map import lab_attributes
from capsbayes.plan.membrane import MembraneFlowDesign
from capsbayes.plan.sobol import SobolStudy
from capsbayes.report.files import posterior_summary

Made = Callable[..., Any]
RESULTS: Mapping[str, tuple[Made, ...]] = {
    "`identify`, also in `summary.json`": (posterior_summary, Posterior.as_dict, Posterior._of_coordinates),
    "`batch`": (batch_summary,),
    "`population`, and under `hierarchy` in that of `batch`": (Hierarchy.as_dict,),
    "`membrane`, also in `membrane.json`": (SharedMembrane.as_dict,),
    "`diagnose`, also in `study.json`": (summary,),
    "`sensitivity budget`, also in `budget.json`": (ErrorBudget.as_dict,),
    "`sensitivity sobol`, also in `sobol.json`": (SobolStudy.as_dict,),
    "`sensitivity flow`, also in `flow.json`": (FlowDesign.as_dict, lab_attributes),
    "`sensitivity flow --membrane unknown`, also in `flow.json`": (MembraneFlowDesign.as_dict, lab_attributes),
    "`simulate`": (SteadyState.as_dict,),
}
"""Functions that write the keys, by the command that prints them."""

HEAD = """
## Keys of `--json`

Numbers are in SI, or in the units of the [table of quantities](../method.md#units). A quantity with an interval has
`median`, `mean`, `sd`, `lower_68`, `upper_68`, `lower_95` and `upper_95`, a check `name`, `value`, `wanted`, `passed`,
and a `caveat` where a p-value passes but is small. What does not apply is `null`, or is left out.
"""
MEANINGS = {
    "agreement": "largest differences of the two engines; of `batch`, between rows and sampled capsules",
    "axial_extent": "L_z over l",
    "axial_length": "L_a over l",
    "best": "the flow rate to choose, and what is expected at it",
    "candidates": "each effect that was tried: size, odds, G_s with it, what remains unexplained",
    "capillary_number": "Ca",
    "capsules": "number of capsules; of `membrane`, a list with misfit, G_s, K_s and a of each",
    "changes_by_the_missing": "how much the answers change by accounting for capsules that cannot be in the sample",
    "confidence": "level of the intervals of the indices",
    "cross_section": "cross-section of the channel",
    "deterministic": "answer of the published method",
    "effects": "effects that the verdict names, or between which it does not decide",
    "engine": "`emcee`, `quadrature` or importance sampling",
    "errors": "the errors of a laboratory for which the plan holds",
    "expected": "the capsules for which the plan holds",
    "experiment": "the experiment, or its file and fingerprint",
    "extra_pressure_drop": "additional pressure drop due to the capsule over mu U/l",
    "files": "fingerprints of the files that were read",
    "finding": "disagreement of the first half: p-value, noise, deviations",
    "flows": "for each flow rate: velocity, number of capsules, misfit, G_s",
    "for_law": "the best set of flow rates for K_s/G_s and h",
    "gates": "checks of the computation",
    "good_mean_velocities": "lowest and highest velocity nearly as good as the best",
    "groups": "number of groups of samples, from which the intervals of the indices come",
    "held_out": "each half with the sizes that the other half tells: log-likelihood ratio, deviations, G_s",
    "hierarchy": "the population, with the keys below",
    "in_question": "explanations that may be right, the likeliest first, each a list of effects that act together",
    "indices": "Sobol indices of each answer by input",
    "inner_pressure": "pressure in the capsule over mu U/l",
    "inputs": "measured and stated numbers with their errors; of a budget, the share of each in the variance",
    "iterations": "number of Newton steps",
    "largest_change_without_them": "largest change of an index without the samples that have no shape",
    "laws": "the membrane laws that were compared: probability, its range over model errors, G_s under each",
    "least_stretch": "smallest Lambda of the capsules kept",
    "left_out": "capsules that could not be used, with the reason",
    "level": "significance level of the finding",
    "limit": "the highest Ca with a steady shape, and the risk of exceeding it",
    "limits": "velocities at which capsules may have no steady shape, and the risk of exceeding the limit",
    "limits_95": "where no disagreement was found, the 95 % interval of each effect that could hide",
    "maximum_tension": "largest principal tension over G_s",
    "mean": "mean of each answer",
    "median": "median of each answer",
    "membrane": "the membrane for which the plan holds",
    "message": "the status as a sentence",
    "minimum_tension": "smallest principal tension over G_s",
    "missing": "number of capsules that had no steady shape, with an interval",
    "model": "name of the model, and its fingerprint where that is not `model_sha256`",
    "model_sha256": "fingerprint of the model",
    "name_power": "of drawn sessions like this one, the share whose effect gets its name",
    "name_wrong": "of drawn sessions like this one whose effect is not tried, the share that gets a wrong name",
    "not_testable": "effects that these data cannot test",
    "notes": "remarks",
    "odd_tails": "quantities whose distribution does not have the tails of the population fitted",
    "outside": "number of samples without a shape of their own",
    "p_values": "predictive p-values of the measured numbers",
    "prior_sensitivity": "how much G_s and a follow the priors (`arviz.psens`); above 0.05 these matter",
    "parachute_depth": "L_p over l",
    "points": "for each velocity: expected widths, share of capsules beyond the limit",
    "prior": "prior of each quantity",
    "prior_sds": "standard deviations of the parameters of the membrane before the measurement",
    "probabilities": "probability of each explanation",
    "quadrature": "intervals by the grid, where emcee gave the quantities",
    "quantities": "the answer: the interval of each quantity",
    "ranges": "distributions of the inputs",
    "refinement": "what was added to the model where the posterior lies, only with `--refine`",
    "residual": "residual of the equations over U",
    "resimulation": "what the simulator says at draws of the posterior, null if it was not asked",
    "reynolds_number": "of the median flow",
    "same_capsule": "whether each capsule is measured at all flow rates",
    "samples": "number of samples",
    "sd": "standard deviation of each answer",
    "sd_of_log_surface_shear_modulus": "found, with the membrane known, and expected after each further measurement",
    "sd_of_logarithm": "standard deviation of the logarithm of each answer",
    "seed": "seed of the random numbers",
    "sentence": "the status or verdict as a sentence",
    "sets": "the best set for G_s of each number of flow rates",
    "settings": "settings of the simulator",
    "share_leaning_on_border": "share of capsules whose posterior reaches the edge of the simulated range",
    "share_next_to_border": "share of the posterior next to each edge of the simulated range or of a prior",
    "share_of_variance_owed_to_what_all_share": "share of the variance that no further capsule reduces",
    "silhouette_extent": "length of the silhouette over l",
    "size_ratio": "a/l",
    "sizes": "size of each named effect",
    "slack": "slack of the condition of volume over U",
    "something_else": "whether an effect outside the catalogue is among the explanations",
    "status": "how the work ended",
    "statuses": "number of capsules by status",
    "stretch_ratio": "Lambda",
    "surface_shear_modulus": "median and 95 % interval of G_s of the session",
    "surface_shear_modulus_over_laws": "least and greatest G_s that other membrane laws would give",
    "tail_p_values": "posterior predictive p-values of the tails",
    "tails": "tails of the population, normal or student",
    "update": "stated median of G_s, that of the capsules alone, and how far apart they are; null without one",
    "variance_of_log_surface_shear_modulus": "share of each source in the variance of ln G_s",
    "velocities": "for each velocity, the risk that capsules have no steady shape",
    "velocity_ratio": "v_o/U",
    "verdict": "what was found",
    "version": "version of the library",
    "width_over_prior": "width of the 68 % interval of each parameter of the membrane over that of its prior",
    "widths_over_prior": "width of the 68 % interval of each parameter of the membrane over that of its prior",
    "with_outline": "number of capsules with an outline",
    "wrinkling_rate": "growth rate of wrinkles about the axis over U/l",
}


def keys_table() -> str:
    """Return the keys of all results with their meanings, a table for each."""
    parts = [HEAD]
    for command, functions in RESULTS.items():
        rows = [f"| `{key}` | {MEANINGS[key]} |" for function in functions for key in keys_of(function)]
        parts.append(f"\n**{command}**\n\n| key | meaning |\n|---|---|\n" + "\n".join(rows) + "\n")
    return "".join(parts)


def keys_of(function: Made) -> Iterator[str]:
    """Yield the outermost keys of the dictionaries that a function returns or declares, in their order."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    for node in ast.walk(tree):
        if isinstance(node, ast.Return | ast.AnnAssign) and node.value is not None:
            yield from _outermost(node.value, inspect.unwrap(function).__globals__)


def _outermost(node: ast.AST, known: Mapping[str, str]) -> Iterator[str]:
    match node:
        case ast.Dict():
            for key, value in zip(node.keys, node.values, strict=True):
                if key is None:
                    yield from _outermost(value, known)  # `**other`
                else:
                    yield ast.literal_eval(key) if isinstance(key, ast.Constant) else known[ast.unparse(key)]
        case ast.DictComp(generators=[ast.comprehension(iter=ast.Tuple() as names)]):
            yield from ast.literal_eval(names)
        case ast.DictComp():
            return
        case _:
            for part in ast.iter_child_nodes(node):
                yield from _outermost(part, known)
