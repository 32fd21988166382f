"""Whether the replicates that a design asks for can say anything in its cells."""

from __future__ import annotations

from collections.abc import Sequence

from study.design.physics import is_homogeneous
from study.design.reader import Faults
from study.design.settings import SCORED
from study.design.spec import Config, Design

#: responses that a fit alone does not give
_NO_CONSTANT = (*SCORED, "seconds")


def check_replicates(design: Design, configs: Sequence[Config], faults: Faults) -> None:
    """Check that every cell has what its replicates vary."""
    asked = design.replicates.noise or design.replicates.mesh_seeds
    if design.analysis.error == "replicates" and not asked:
        rule = "is the scatter of replicates, and the design asks for none"
        faults.add("analysis.error", rule, "add [replicates] mesh_seeds = 5 or noise = 200")
    if design.replicates.noise:
        _check_noise(design, configs, faults)
    if design.replicates.mesh_seeds and not any(_meshed(config) for config in configs):
        rule = (
            "every cell is compression between frictionless plates, which is the same on every "
            "mesh: there is no scatter of meshes to learn"
        )
        faults.add("replicates.mesh_seeds", rule, "leave it out, or vary something with a mesh")


def _check_noise(design: Design, configs: Sequence[Config], faults: Faults) -> None:
    where = "replicates.noise"
    given = sum(config["calibration"]["method"] == "none" for config in configs)
    if given:
        rule = (
            "fits again to the measured curve with resampled residuals, but in "
            f"{given} of {len(configs)} cells the constants are given and nothing is fitted"
        )
        faults.add(where, rule, 'write calibration.method = "auto", or use mesh_seeds')
    if not any(is_constant(response.name) for response in design.responses):
        rule = "says how much calibrated constants scatter, and no response is one"
        faults.add(where, rule, 'add [[response]] name = "mu0" (or C10, ...), or use mesh_seeds')


def is_constant(response: str) -> bool:
    """Whether a response is a constant or mu0, which a fit gives without a prediction.

    Examples
    --------
    >>> is_constant("mu0"), is_constant("C10"), is_constant("work_error")
    (True, True, False)
    """
    return response not in _NO_CONSTANT


def _meshed(config: Config) -> bool:
    """Whether a mesh can change an answer of a cell: its scored test or its calibration."""
    fitted = config["calibration"]["problem"] or config
    return not (is_homogeneous(config) and is_homogeneous(fitted))
