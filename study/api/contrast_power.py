"""Differences of two settings that an analyst names, of a finished analysis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.api.analyzing import analyze
from study.ground.errors import Fault, InputError, MissingDataError, StudyError, nearest
from study.harness.design.load import RESULTS, design_root, load_design
from study.harness.design.spec import Design, ResponseSpec
from study.harness.runner.expansion import expand
from study.simulation.tasks import Costs, default_jobs
from study.statistics.analysis.analysis_request import on_scale, threshold
from study.statistics.analysis.analysis_result import AnalysisResult
from study.statistics.analysis.anova_table import Contrast
from study.statistics.analysis.post_hoc import named_contrasts
from study.statistics.analysis.power import PlannedVerdicts, fewest_blocks, planned_verdicts


def contrasts(found: AnalysisResult, asked: str | Sequence[str]) -> tuple[Contrast, ...]:
    """Estimate differences of sets of cells that the analyst names.

    Parameters
    ----------
    found : AnalysisResult
        Of :func:`analyze` or :func:`study.anova`.
    asked : str or sequence of str
        Such as ``"material=stiff, range=60 % - material=soft, range=60 %"``; a factor that a
        side leaves out is averaged over.

    Returns
    -------
    tuple of Contrast
        Difference, its interval alone and with all others together, p, Holm's p, U, verdict.

    Raises
    ------
    InputError
        For a factor or level that does not exist, or a setting without a row.
    """
    asked = [asked] if isinstance(asked, str) else list(asked)
    estimated, faults = named_contrasts(found, asked)
    if faults:
        raise InputError(faults)
    return estimated


# What a number of specimens can show, before they are tested: probability of a claim, and cost.

#: Numbers of specimens that are compared.
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20)
#: Scatter between specimens over the difference that matters, where nothing is known of it.
ASSUMED = (0.1, 0.3, 1.0)


@dataclass(frozen=True)
class ContrastDetection:
    """What specimens can show of one response."""

    #: Of the response and of its differences.
    response: str
    unit: str
    #: Whether differences are ratios; ``practical``, ``sd`` and ``u`` are then logarithms.
    ratio: bool
    practical: float
    #: Standard deviation over specimens of a difference between two cells.
    sd: float
    source: str
    #: Bound of the numerical error that is reckoned with.
    u: float
    #: One for each number of specimens.
    rows: tuple[PlannedVerdicts, ...]
    #: Fewest specimens for a probability of the right claim.
    enough: tuple[tuple[float, int | None], ...]


@dataclass(frozen=True)
class Power:
    """What a design can detect, response by response, and what could not be said."""

    study: str
    blocks: int
    detections: tuple[ContrastDetection, ...]
    warnings: tuple[str, ...]


def power(
    design: Design | str | Path,
    *,
    sd: float | Mapping[str, float] | None = None,
    data: str | Path | None = None,
    results: str | Path = RESULTS,
    overrides: Sequence[str] = (),
    counts: Sequence[int] = COUNTS,
) -> Power:
    """Say what numbers of specimens can detect, and at which cost.

    Parameters
    ----------
    design : Design, str or Path
        The study.
    sd : float or mapping of str to float, optional
        Standard deviation over specimens of a difference between two cells, in the unit of the
        response, for all responses or by their names. By default that of the study's own results;
        without them three are assumed.
    data : str or Path, optional
        Folder that measurement files are relative to.
    results : Path
        Folder of the results, which give the scatter where the study has run.
    overrides : sequence of str
        Keys of the design with other values.
    counts : sequence of int
        Numbers of specimens to compare.

    Returns
    -------
    Power
        For every response and scatter, the probability of each verdict and the cost.

    Raises
    ------
    InputError
        For a faulty design, or a design none of whose responses says what matters.
    """
    loaded = load_design(design, overrides)
    names = [response.name for response in loaded.responses]
    scatter = {} if sd is None else sd if isinstance(sd, Mapping) else dict.fromkeys(names, sd)
    for name, value in scatter.items():
        if name not in names:
            raise InputError(Fault("--sd", f"{name!r} is no response", nearest(name, names)))
        if not (math.isfinite(value) and value > 0):
            raise InputError(Fault("--sd", f"must be a positive number, got {value!r}"))
    warnings: list[str] = []
    blocks, seconds = _planned(loaded, design_root(loaded, data), warnings)
    detections: list[ContrastDetection] = []
    for response in loaded.responses:
        if response.practical is None:
            warnings.append(f"{response.name}: nothing says which difference matters")
            continue
        spread = scatter.get(response.name)
        detections += _detections(loaded, response, spread, results, seconds, counts, warnings)
    if not detections and all(r.practical is None for r in loaded.responses):
        mend = 'write, for example, practical = "2 pp" in its [[response]]'
        raise InputError(Fault("response", "none says which difference matters", mend))
    return Power(loaded.name, blocks, tuple(detections), tuple(warnings))


def _planned(design: Design, root: Path, warnings: list[str]) -> tuple[int, float | None]:
    """Blocks of the measurements, and seconds of one case on all workers."""
    try:
        work = expand(design, root)
    except MissingDataError as error:
        warnings.append(f"no cost, for the measurements are missing: {error}")
        return 0, None
    costs = Costs()
    seconds = costs.total_seconds(list(work.fits.values()), work.jobs, default_jobs())
    return max(len(work.blocks), 1), seconds / max(len(work.jobs), 1)


def _detections(
    design: Design,
    response: ResponseSpec,
    sd: float | None,
    results: str | Path,
    seconds: float | None,
    counts: Sequence[int],
    warnings: list[str],
) -> list[ContrastDetection]:
    known_scatter = _known(design, response, results)
    practical = _practical(response, known_scatter)
    if practical is None:
        warnings.append(
            f"{response.name}: its practical difference is a share of a mean that no result gives "
            "yet; run the design once, or state it in the unit of the response"
        )
        return []
    u = 0.0 if known_scatter is None else known_scatter[1]
    choices = [(share * practical, f"assumed: {share:g} of what matters") for share in ASSUMED]
    if sd:
        choices = [(sd, "as given")]
    elif known_scatter is not None:
        choices = [(known_scatter[0], "of the results")]
    cells = len(design.treatments)
    powers = (0.8, 0.9)
    return [
        ContrastDetection(
            response.name,
            "pp" if response.unit == "%" else response.unit,
            response.transform == "log",
            practical,
            spread,
            source,
            u,
            planned_verdicts(counts, spread, practical, u=u, cells=cells, seconds=seconds),
            tuple(zip(powers, fewest_blocks(spread, practical, u=u, powers=powers), strict=True)),
        )
        for spread, source in choices
        if spread
    ]


def _practical(response: ResponseSpec, scatter: tuple[float, float, float] | None) -> float | None:
    limit = threshold(response.practical)
    # without a mean a share is known on the logarithm alone, and a difference off it alone
    if limit is None or (scatter is None and limit.relative != (response.transform == "log")):
        return None
    return on_scale(limit, 1.0 if scatter is None else scatter[2], response.transform)


def _known(
    design: Design, response: ResponseSpec, results: str | Path
) -> tuple[float, float, float] | None:
    """Scatter of a difference over specimens, numerical bound and mean, from stored results."""
    folder = Path(results) / design.name
    if not folder.is_dir():
        return None
    try:
        analysis = analyze(str(folder), response.name)
    except StudyError:
        return None
    spread = _scatter(analysis)
    if spread is None or analysis.grand_mean is None:
        return None
    u = max((e.u_num for e in analysis.effects if e.u_num is not None), default=0.0)
    log = analysis.request.scale.transform == "log"
    return spread, u / analysis.grand_mean if log else u, analysis.grand_mean


def _scatter(analysis: AnalysisResult) -> float | None:
    """Largest standard deviation over blocks of a simple effect, on the working scale."""
    from scipy.special import stdtrit

    if analysis.error_term.source != "E1":
        return None
    blocks = analysis.residuals["block"].nunique()
    t = float(stdtrit(blocks - 1, 1 - analysis.request.alpha / 2))
    change = math.log if analysis.request.scale.transform == "log" else float
    halves = [
        (change(e.ci[1]) - change(e.ci[0])) / 2
        for effect in analysis.effects
        for e in effect.simple_effects
        if e.ci is not None
    ]
    return max(halves) * math.sqrt(blocks) / t if halves else None
