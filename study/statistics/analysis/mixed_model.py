"""Mixed models by REML: fixed and random factors, incomplete blocks, studies of precision.

Blocks that lack some cells keep what they tell: between blocks as far as their scatter allows,
within blocks fully (recovery of interblock information, Yates 1940, Ann. Eugen. 10, 317-325).
Tests and intervals of fixed effects are those of Kenward and Roger (1997), intervals of
standard deviations those of the profile of the restricted likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np
import scipy

from study.ground.arrays import Array, gathered, one_thread
from study.ground.errors import Fault, InputError, nearest
from study.ground.tabular import names_of
from study.ground.units import unit_of_column
from study.statistics.analysis.analysis_request import (
    Blocking,
    Practical,
    ResponseScale,
    alpha_faults,
    on_scale,
    threshold,
    unchecked_unit,
)
from study.statistics.analysis.comparisons import pooled_multiplier, t_quantile
from study.statistics.analysis.data import Data, prepare, refuse_copied_rows, structure_of
from study.statistics.analysis.effects import (
    DOUBT,
    UNEQUAL,
    Gate,
    Rival,
    Scale,
    TermEstimate,
    sampled_estimate,
    size,
)
from study.statistics.analysis.gate import (
    LACK,
    any_shape,
    block_means,
    limit_rivals,
    rival_of_lack,
    rival_of_rounding,
)
from study.statistics.analysis.linear_model import (
    ALIAS_TOLERANCE,
    CellLayout,
    Model,
    ModelMatrix,
    Term,
    model_matrix,
    nested_in,
    term_name,
    terms_of,
)
from study.statistics.analysis.post_hoc import possible_contrasts, with_holm
from study.statistics.analysis.restricted_likelihood import (
    MOST_CROSSED,
    Likelihood,
    RestrictedFit,
    Sandwich,
    SingularError,
    fit_restricted,
)
from study.statistics.analysis.simple_effects import (
    NO_DIFFERENCE,
    Confidence,
    Differences,
    Estimates,
)
from study.statistics.analysis.sums_of_squares import (
    Factored,
    FRatioTest,
    extra_sum,
    factor,
    term_sums,
)

if TYPE_CHECKING:
    import pandas as pd

    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Contrast, Effect


WITHIN = "within"
#: Levels of a random factor that its scatter needs.
FEWEST_LEVELS = 3
_NOTHING_RANDOM = Fault(
    "random",
    "no random factor is named",
    "name the blocks, or the random factors: --random day,day:run",
)
#: Rows without random factors whose pairs are weighed to judge unequal scatter.
_MOST_ROWS = 1000
#: Level of the tests of effects that differ between blocks, all of a model together. Claims of 4 x
#: 4 blocks with the true difference at the limit, at .25, .1, .05: wrong ones at most .09, .13,
#: .15; right ones of a difference of 3.3 times the limit .70, .80, .85, and .89 without the tests.
_DIFFERS = 0.1

#: Level of the test whether the level before acts on. Of 60 crossovers each, 12 or 24 subjects, at
#: .05, .25, .5: right claims without what acts on .83 to 1, .63 to .95, .42 to .90; wrong ones,
#: where it moves the difference by half of the limit, .40 to .78, .27 to .62, .20 to .43.
_ACTS_ON = 0.05

#: Columns of a model beside which the interactions of factors with blocks are tested.
_MOST_COLUMNS = 1000


@dataclass(frozen=True)
class VarianceComponent:
    """Standard deviation of one source of scatter, in the unit of the response."""

    #: A random factor or an interaction, or ``"within"``.
    source: str
    #: REML estimate; 0 at the boundary.
    sd: float
    #: Interval by the profile of the restricted likelihood.
    low: float
    high: float
    share: float


@dataclass(frozen=True)
class MixedTerm:
    """F test of one term as of Kenward and Roger: F is scaled, as are its error's df."""

    term: str
    df: int
    f: float
    df_error: float
    p: float


@dataclass(frozen=True)
class Slope:
    """Change of the response for each unit of a covariate, with its interval."""

    covariate: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class MixedModel:
    """A fitted mixed model."""

    components: tuple[VarianceComponent, ...]
    #: Type III tests of the factors and covariates.
    terms: tuple[MixedTerm, ...]
    deviance: float
    rows: int
    slopes: tuple[Slope, ...] = ()
    #: Means, differences and verdicts of the factors; means are those at the mean of each
    #: covariate.
    effects: tuple[Effect, ...] = ()
    contrasts: tuple[Contrast, ...] = ()
    #: What the names of the random factors leave open.
    notes: tuple[str, ...] = ()


@one_thread
def mixed_model(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    *,
    block: str | Sequence[str] | None = None,
    random: Sequence[str] = (),
    covariates: Sequence[str] = (),
    model: Model = "full",
    practical: Practical = None,
    contrasts: Sequence[str] = (),
    copies: str = "refuse",
    alpha: float = 0.05,
    seed: int = 2011,
) -> MixedModel:
    """Fit a mixed model by REML.

    Parameters
    ----------
    table : DataFrame
        One row a run; blocks may lack cells.
    response : str
        Column of the response.
    factors : sequence of str
        Columns of the fixed factors; without any, the mean is the only fixed effect.
    block : str or sequence of str, optional
        Columns of blocks, which are random; several cross. With covariates alone nothing has to
        be random: the analysis of covariance by least squares.
    random : sequence of str
        A fixed factor (its interaction with the blocks is random too), any other column
        (``"day"``), or an interaction of columns (``"day:run"``, runs within days).
    covariates : sequence of str
        Numeric columns (a temperature, a mass) that the response follows in a straight line.
    model : "full", int or list
        Fixed terms; see :func:`study.statistics.analysis.linear_model.terms_of`.
    practical : optional
        Smallest difference that matters; see ``threshold``.
    contrasts : sequence of str
        Differences by name: ``"material=stiff - material=soft"``.
    copies : {"refuse", "independent"}
        Whether rows or blocks that repeat others in every digit are refused.
    alpha : float
        One minus the level of the intervals.
    seed : int
        Of the simulated multipliers of simultaneous intervals.

    Returns
    -------
    MixedModel
        Variance components with intervals, tests of the fixed terms, slopes of the covariates,
        effects with verdicts.

    Raises
    ------
    InputError
        For a random factor with fewer than three levels, terms that the rows cannot tell, or a
        covariate that is no number in some row.
    RefusedError
        If rows or blocks are copies of others.
    """
    if faults := [*alpha_faults(alpha), *Blocking(copies=copies).faults()]:
        raise InputError(faults)
    blocks = names_of(block)
    sources = random_terms(factors, blocks, random)
    if not (sources or covariates):
        raise InputError([_NOTHING_RANDOM])
    columns = list(dict.fromkeys(name for term in sources for name in term if name not in factors))
    fixed_columns, others = (list(factors), columns) if factors else (columns[:1], columns[1:])
    data = prepare(table, response, fixed_columns, others)
    if factors and copies == "refuse":
        refuse_copied_rows(data)
    terms = terms_of(factors, model) if factors else ()
    bare = model_matrix(data.layout, terms)
    shift = float(data.y.mean())
    values = {name: _numbers(table, name, data) for name in covariates}
    about_mean: dict[Term, Array] = {(name,): x - x.mean() for name, x in values.items()}
    fixed = factor(_with_columns(bare, about_mean), data.y - shift)
    _check(data, fixed)
    fit = fit_sources(data, fixed, sources)
    cells = MixedCells(fit, fixed, bare, shift, Confidence(alpha, seed))
    tests = {s.term: fit.test(s.basis) for s in term_sums(fixed, "III") if s.df}
    limit = threshold(practical, unit_of_column(response))
    difference = on_scale(limit, shift)
    specimens = len(data.layout.levels[blocks[0]]) if blocks else None
    scale = Scale("none", difference, None, deterministic=False, specimens=specimens)
    with _determined(sources):
        scatter = components(fit, [*map(term_name, sources), WITHIN], alpha)
    rivals = _rivals_of_scatter(cells, data, sources) if factors else []
    working = ResponseScale(practical=limit)
    has_blocks = bool(factors) and data.block is not None
    means = block_means(data, data.y) if has_blocks else shift + fixed.residual
    rivals += limit_rivals(working, alpha, cells.sample, means)
    refitted = _refitted(cells, data, sources)
    rivals += _lack_of_fit(cells, terms, factors, refitted)
    for name, x in values.items():
        rivals += _unequal_slopes(cells, name, x, refitted)
        rivals += _unequal_means(cells, bare, name, x)
    gate = Gate(bare, scale, cells.sample, tuple(rivals))
    named, faults = possible_contrasts(gate, data, contrasts)
    if faults:
        raise InputError(faults)
    p, judged = {term: test.p for term, test in tests.items()}, gate.judged(terms)
    return MixedModel(
        scatter,
        tuple(MixedTerm(term_name(t), int(s.df), s.f, s.df_error, s.p) for t, s in tests.items()),
        fit.deviance,
        data.y.size,
        tuple(cells.slope(name) for name in covariates),
        with_holm([size(e, scale, judged) for e in cells.estimates(terms, p)]),
        named,
        (
            *(
                f"{inner} {data.layout.levels[inner][0]} is taken as the same {inner} in every "
                f"{outer}; {_numbered_anew(outer, inner)}"
                for outer, inner in _recurring_numbers(data.layout, sources)
            ),
            *gate.notes,
            *unchecked_unit(practical, response),
        ),
    )


#: Refits the rows with other columns; the columns of the factors stand first.
Refit = Callable[[ModelMatrix, ModelMatrix], "MixedCells | None"]


def _refitted(cells: MixedCells, data: Data, sources: Sequence[Term]) -> Refit:
    def refit(matrix: ModelMatrix, factors: ModelMatrix) -> MixedCells | None:
        fixed = factor(matrix, data.y - cells.shift)
        if not fixed.is_full or fixed.df_residual <= 0:
            return None
        try:
            fit = fit_sources(data, fixed, sources)
        except InputError:  # the rows do not tell its variances
            return None
        return replace(cells, fit=fit, fixed=fixed, factors=factors)

    return refit


def _lack_of_fit(
    cells: MixedCells, terms: Sequence[Term], factors: Sequence[str], refit: Refit
) -> list[Rival]:
    """Rival of all interactions of the factors, where the rows do not rule them out."""
    every = [*terms, *(t for t in terms_of(factors) if t not in terms)] if factors else []
    if len(every) == len(terms) or nested_in(terms):
        return []
    bare, matrix = model_matrix(cells.factors.layout, every), cells.fixed.matrix
    covariates = matrix.terms[len(cells.factors.terms) :]
    whole = refit(
        _with_columns(bare, {t: matrix.columns[:, matrix.of(t)] for t in covariates}), bare
    )
    return [] if whole is None else rivals_of_lack(whole, terms)


def rivals_of_lack(
    whole: MixedCells, declared: Sequence[Term], p_of: Callable[[Array], float] | None = None
) -> list[Rival]:
    """Rival of the full model, where what the declared one leaves out may not be zero.

    ``p_of`` is another test of each term left out.
    """
    sums = term_sums(whole.fixed, "III")
    named = {t for t in whole.factors.terms if t and t not in declared}
    bases = [s.basis for s in sums if s.term in named and s.df]
    if not bases:
        return []
    test = whole.fit.test(np.hstack(bases))
    p = min(test.p, *(len(bases) * p_of(basis) for basis in bases)) if p_of else test.p
    return [rival_of_lack(f"{LACK}: {test.words} by REML", p, whole.sample, whole.factors)]


def _unequal_slopes(cells: MixedCells, name: str, x: Array, refit: Refit) -> list[Rival]:
    """Rivals where the response follows a covariate with slopes that may differ between cells.

    A difference is then judged at the mean of the covariate, and one that is to be small at both
    ends of its range as well.
    """

    def at(value: float) -> MixedCells | None:
        slopes = cells.factors.columns[:, 1:] * (x - value)[:, None]
        term = name, *map(term_name, cells.factors.terms[1:])
        return refit(_with_columns(cells.fixed.matrix, {term: slopes}), cells.factors)

    middle = at(float(x.mean()))
    if middle is None:
        return []
    test = middle.fit.test(middle.fixed.space(len(middle.fixed.matrix.terms) - 1, "I").basis)
    if test.p >= DOUBT:
        return []
    which = f"slopes of {name} may differ between levels ({test.words})"
    note = f"{which}: differences are those at its mean"
    ends = [(value, at(value)) for value in (float(x.min()), float(x.max()))]
    why = f"{note}, where its interval does not allow the claim"
    return [Rival(why, middle.sample, note=f"{note} ({x.mean():.4g})")] + [
        Rival(
            f"{note}, and larger ones at {name} = {value:g} are not ruled out",
            end.sample,
            (NO_DIFFERENCE,),
        )
        for value, end in ends
        if end is not None
    ]


def _unequal_means(cells: MixedCells, factors: ModelMatrix, name: str, x: Array) -> list[Rival]:
    """Condition of claims where levels differ in a covariate, which may be measured with error.

    Its slope is then too small by its reliability, which these rows do not tell, and that much of
    the difference in the covariate is left in a difference of the response (Fuller 1987,
    *Measurement Error Models*, section 1.1). Of levels that do not differ in it nothing is left.
    """
    whole = factor(factors, x)
    df = whole.rank - 1
    test = extra_sum(whole.tss - whole.rss, df, whole.rss, whole.df_residual)
    if test is None or test.p >= DOUBT:
        return []
    condition = f"if {name} is measured without error"
    note = f"claims hold only {condition}: levels differ in it ({test.words})"
    return [Rival("", cells.sample, claims=(), note=note, condition=condition)]


def _recurring_numbers(layout: CellLayout, sources: Sequence[Term]) -> Iterator[tuple[str, str]]:
    """Pairs of random factors of which the second has numbers for names, fewer than the first.

    Runs that are numbered anew on every day are levels within the day, and look like levels that
    cross the days.
    """
    single = [term[0] for term in sources if len(term) == 1]
    for outer, inner in permutations(single, 2):
        numbers = [str(level) for level in layout.levels[inner]]
        is_fewer = len(numbers) < len(layout.levels[outer])
        if is_fewer and all(map(str.isdigit, numbers)) and {outer, inner} not in map(set, sources):
            yield outer, inner


def _numbered_anew(outer: str, inner: str) -> str:
    return f"if it is numbered anew in each {outer}, name it {outer}:{inner}"


def _rivals_of_scatter(cells: MixedCells, data: Data, sources: Sequence[Term]) -> list[Rival]:
    """Rivals by rounding, the shape of the scatter and how effects differ between blocks."""
    rivals: list[Rival] = []
    if step := structure_of(data).resolution:
        rivals.append(rival_of_rounding(cells.sample, cells.along, step / math.sqrt(12)))
    if data.y.size > _MOST_ROWS:
        return rivals
    if not sources:
        return [*rivals, _unequal_rows(cells)]
    if sources == ((data.block,),):
        block = data.layout.codes[str(data.block)]
        rivals.append(rival_of_shape(cells, Sandwich(cells.fit, block)))
    return rivals + rivals_of_unequal_effects(cells, data, sources)


def rival_of_shape(cells: MixedCells, sandwich: Sandwich) -> Rival:
    """Rival without a normal distribution of what each block adds to a difference."""

    def of_blocks(rows: Array) -> Array:
        along = cells.along(rows)
        parts = sandwich.parts(along)[0]
        return parts.T + (along @ cells.fit.moments.beta)[:, None] / len(parts)

    blocks = [np.arange(int(sandwich.block.max()) + 1)]
    y = cells.fit.likelihood.y + cells.shift
    return any_shape(cells.confidence, cells.sample, of_blocks, blocks, y)


def rivals_of_unequal_effects(
    cells: MixedCells, data: Data, sources: Sequence[Term]
) -> list[Rival]:
    """Rivals where effects may differ between the levels of a block beyond the rest of the scatter.

    A model without these interactions takes them for scatter of single rows, of which there are
    many, where an effect is known from as many levels as the block has. Intervals then reach as
    far as the scatter over these levels tells (CR2).
    """
    # what is random counts as fixed: it is no part of what effects differ by
    dummies = model_matrix(data.layout, [], extra=sources).columns[:, 1:]
    columns, y = np.column_stack([cells.fixed.columns, dummies]), cells.fit.likelihood.y
    terms = [term for term in cells.factors.terms if term and set(term) <= set(data.factors)]
    tests: list[tuple[str, tuple[Term, FRatioTest]]] = []
    for block in (source[0] for source in sources if len(source) == 1):
        declared = [set(source) - {block} for source in sources if block in source]
        left_out = [term for term in terms if set(term) not in declared]
        seen = [(term, _added(columns, data.layout, (block, *term), y)) for term in left_out]
        tests += [(block, (term, test)) for term, test in seen if test is not None]
    rivals = []
    for block, of_block in gathered(tests).items():
        term, test = min(of_block, key=lambda pair: pair[1].p)
        if test.p * len(tests) >= _DIFFERS:
            continue
        which = f"{term_name(term)} may differ between the levels of {block} ({test.words})"
        note = f"{which}, which the model leaves out"
        wide = replace(cells, robust=Sandwich(cells.fit, data.layout.codes[block]).errors)
        why = f"{note}: its scatter over {block} does not allow the claim"
        rivals.append(Rival(why, wide.sample, note=note))
    return rivals


def rivals_beside_crossing_blocks(out: AnalysisResult, fit: Factored) -> list[Rival]:
    """Rivals of a model of factors and blocks that cross, by how effects differ between blocks."""
    data, request = out.data, out.request
    if len(data.blocks) < 2 or not fit.df_residual or out.y.size > _MOST_ROWS:
        return []
    rows = fit_restricted(fit.q, out.y - fit.shift, [])
    cells = MixedCells(rows, fit, fit.matrix, fit.shift, request.confidence)
    rivals = rivals_of_unequal_effects(cells, data, [(name,) for name in data.blocks])
    for name, (subject, period) in product(data.factors, permutations(data.blocks, 2)):
        before = _level_before(data.layout, name, subject, period)
        apart = before - fit.q @ (fit.q.T @ before)
        if np.linalg.norm(apart) > ALIAS_TOLERANCE * np.linalg.norm(before) or not before.any():
            continue  # it shows in the scatter within the blocks
        rivals += _rivals_of_carry_over(cells, data, before, (name, subject, period))
    return rivals


def _level_before(layout: CellLayout, name: str, subject: str, period: str) -> Array:
    """Contrasts (n, k - 1) of the level that a subject had in the period before; 0 in the first."""
    contrasts = model_matrix(layout, [(name,)]).columns[:, 1:]
    pairs = zip(layout.codes[subject].tolist(), layout.codes[period].tolist(), strict=True)
    index = {pair: row for row, pair in enumerate(pairs)}
    before = np.zeros_like(contrasts)
    for (s, p), row in index.items():
        if (s, p - 1) in index:
            before[row] = contrasts[index[s, p - 1]]
    return before


def _rivals_of_carry_over(
    cells: MixedCells, data: Data, before: Array, names: tuple[str, str, str]
) -> list[Rival]:
    """Rival in which the level before acts on, where subjects tell it alone (Grizzle 1965).

    In a crossover of two periods a treatment that still acts in the second is no part of the
    scatter within subjects, but of the difference of the treatments. The test between subjects has
    too little power to exclude it (Freeman 1989, Statist. Med. 8, 1421-1432), whichever its size:
    a claim names the condition that it rests on.
    """
    (name, subject, period), y = names, cells.fit.likelihood.y
    terms = [term for term in cells.factors.terms if term and set(term) <= set(data.factors)]
    others = [(block,) for block in data.blocks if block != subject]
    bare = model_matrix(data.layout, terms)
    blocks = model_matrix(data.layout, others).columns[:, 1:]
    more: dict[Term, Array] = {("blocks",): blocks, (f"{name} before",): before}
    fixed = factor(_with_columns(bare, more), y)
    try:
        fit = fit_restricted(fixed.q, y, [data.layout.codes[subject]])
    except SingularError:
        return []
    basis = fixed.space(len(fixed.matrix.terms) - 1, "I").basis
    if not fixed.is_full:
        return []
    test = fit.test(basis)
    seen = f"{test.words}, between {subject}s"
    if test.p >= _ACTS_ON:
        condition = f"if no effect of {name} carries over into the next {period}"
        note = f"claims hold only {condition}, which these rows hardly tell ({seen})"
        return [Rival("", cells.sample, claims=(), note=note, condition=condition)]
    note = f"the effect of {name} may carry over into the next {period} ({seen})"
    with_carry_over = replace(cells, fit=fit, fixed=fixed, factors=bare, robust=None)
    why = f"{note}: without what it carries over the interval does not allow the claim"
    return [Rival(why, with_carry_over.sample, matrix=bare, note=note)]


def _added(columns: Array, layout: CellLayout, term: Term, y: Array) -> FRatioTest | None:
    """Test what a term adds to other columns (n, p) of rows y (n,); None where nothing is left."""
    matrix = ModelMatrix(columns, ((),), (slice(0, columns.shape[1]),))
    every = _with_columns(matrix, {term: model_matrix(layout, [term]).columns})
    if every.columns.shape[1] > _MOST_COLUMNS:
        return None
    without, whole = factor(matrix, y), factor(every, y)
    df = without.df_residual - whole.df_residual
    return extra_sum(without.rss - whole.rss, df, whole.rss, whole.df_residual)


def _unequal_rows(cells: MixedCells) -> Rival:
    """Rival without random factors, whose rows may scatter unequally (CR2 of single rows, HC2)."""
    sandwich = Sandwich(cells.fit, np.arange(cells.fit.likelihood.y.size))

    def estimate(differences: Differences) -> Estimates:
        estimates = cells.sample(differences)
        error, df = sandwich.errors(cells.along(differences.rows))
        alpha = cells.confidence.alpha
        every = t_quantile(alpha / (2 * max(len(df), 1)), df)
        return Estimates(estimates.value, error, t_quantile(alpha / 2, df), every)

    return Rival(UNEQUAL, estimate)


def random_terms(
    factors: Sequence[str], blocks: Sequence[str], random: Sequence[str]
) -> tuple[Term, ...]:
    """Random terms: the blocks, interactions of fixed factors with them, and other columns."""
    terms: list[Term] = [(name,) for name in blocks]
    faults = [] if terms or random or factors else [_NOTHING_RANDOM]
    for text in random:
        term = tuple(part.strip() for part in text.split(":"))
        if not set(term) <= set(factors):
            terms.append(term)
            continue
        terms += [(name, *term) for name in blocks]
        if not blocks:
            rule = f"{text!r} is a fixed factor, whose effect cannot be random without blocks"
            mend = f"name the blocks, or leave {text!r} out of the factors"
            faults.append(Fault("random", rule, mend))
    if faults:
        raise InputError(faults)
    return tuple(dict.fromkeys(terms))


def fit_sources(data: Data, fixed: Factored, sources: Sequence[Term]) -> RestrictedFit:
    """Fit the variances of random terms by REML, beside fixed columns."""
    codes = [np.unique(data.layout.cell(term), return_inverse=True)[1] for term in sources]
    faults = []
    for term, code in zip(sources, codes, strict=True):
        where, levels = f"random factor {term_name(term)!r}", int(code.max()) + 1
        if levels < FEWEST_LEVELS:
            rule = f"has {levels} levels: the scatter over them needs {FEWEST_LEVELS}"
            pairs = _recurring_numbers(data.layout, sources)
            anew = [_numbered_anew(*pair) for pair in pairs if term == pair[1:]]
            faults.append(Fault(where, rule, *anew[:1]))
        elif levels == data.y.size:
            rule = "has a level of its own in every row, so it is the scatter within"
            faults.append(Fault(where, rule, "leave it out"))
    if faults:
        raise InputError(faults)
    crossed = Likelihood(fixed.q, data.y, tuple(codes)).crossed_levels
    if crossed > MOST_CROSSED:
        rule = f"{crossed:,} levels of random factors cross each other, at most {MOST_CROSSED:,}"
        raise InputError(Fault("random", rule, "name fewer random factors, or average first"))
    y = data.y - float(data.y.mean())
    with _determined(sources):
        return fit_restricted(fixed.q, y, codes)


@contextmanager
def _determined(sources: Sequence[Term]) -> Iterator[None]:
    """Name the random factor whose scatter the rows do not determine."""
    try:
        yield
    except SingularError as error:
        names = [*map(term_name, sources), WITHIN]
        if error.which == len(sources):
            rule = "no scatter is left within the levels of the random factors"
            mend = f"leave {names[-2]!r} out of the random factors"
        else:
            rule = f"these rows do not tell the scatter over {names[error.which]!r} from the rest"
            mend = "leave it out of the random factors"
        raise InputError(Fault("mixed model", rule, mend)) from error


def components(
    fit: RestrictedFit, names: Sequence[str], alpha: float
) -> tuple[VarianceComponent, ...]:
    """Find standard deviations, their intervals and shares of the variance."""
    total = float(fit.v.sum())
    return tuple(
        VarianceComponent(name, float(v) ** 0.5, *fit.interval(i, alpha), float(v) / total)
        for i, (name, v) in enumerate(zip(names, fit.v, strict=True))
    )


@dataclass(frozen=True)
class MixedCells:
    """A fitted mixed model as means and differences of its cells."""

    #: In the orthonormal columns of ``fixed``.
    fit: RestrictedFit
    #: Fixed columns; those of ``factors`` stand first.
    fixed: Factored
    #: Columns of the factors alone, without covariates.
    factors: ModelMatrix
    #: What was taken off the response.
    shift: float
    confidence: Confidence
    #: Standard errors and df of combinations that do not rest on the model's variances: intervals
    #: reach as far as both tell.
    robust: Callable[[Array], tuple[Array, Array]] | None = None

    @cached_property
    def of_factors(self) -> Factored:
        """The fit as combinations of the factors' columns see it."""
        return replace(self.fixed, matrix=self.factors)

    def _padded(self, rows: Array) -> Array:
        return np.pad(rows, ((0, 0), (0, self.fixed.columns.shape[1] - rows.shape[1])))

    def along(self, rows: Array) -> Array:
        """Turn combinations of the factors' coefficients to the orthonormal columns."""
        return np.asarray(self._padded(rows) @ self.fixed.inverse)

    @cached_property
    def _root(self) -> Array:
        values, vectors = np.linalg.eigh(self.fit.adjusted)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))

    def sample(self, differences: Differences) -> Estimates:
        """Differences of settings with the multipliers of their intervals."""
        settings = self.along(differences.settings)
        rows = differences.of(settings)
        value, error, df = self.fit.estimate(rows)
        ok = self.fixed.estimable(self._padded(differences.rows)) & (error > 0)
        value, alpha = np.where(ok, value, np.nan), self.confidence.alpha
        single = t_quantile(alpha / 2, df)
        if not ok.any():
            return Estimates(value, error, single, single)
        some = replace(differences.take(ok), settings=settings @ self._root)
        least = float(df[ok].min())  # the least sure contrast decides for all
        wide = pooled_multiplier(some, error[ok], least, self.confidence)
        if self.robust is None:
            return Estimates(value, error, single, wide, df)
        own_error, own_df = self.robust(rows)
        own_single = t_quantile(alpha / 2, own_df)
        # at the error probability that each interval has among all of them
        own_every = t_quantile(float(scipy.special.stdtr(least, -wide)), own_df)
        every = np.maximum(wide * error, own_every * own_error)
        is_wider = ok & (own_single * own_error > single * error)
        error, single, df = np.where(is_wider, (own_error, own_single, own_df), (error, single, df))
        every = np.divide(every, error, out=np.zeros_like(error), where=ok)
        return Estimates(value, error, single, every, df)

    def estimates(self, terms: Sequence[Term], p: dict[Term, float]) -> list[TermEstimate]:
        """Estimates of the terms with their p."""
        fit = replace(self.of_factors, shift=self.shift)
        return [sampled_estimate(fit, t, p.get(t), self.sample) for t in terms]

    def slope(self, covariate: str) -> Slope:
        """Slope of a covariate with its interval."""
        at = self.fixed.matrix.of((covariate,)).start
        estimate = self.fit.estimate(self.fixed.inverse[at : at + 1])
        value, error, df = (float(part[0]) for part in estimate)
        half = t_quantile(self.confidence.alpha / 2, df) * error
        return Slope(covariate, value, value - half, value + half)


def _with_columns(matrix: ModelMatrix, values: Mapping[Term, Array]) -> ModelMatrix:
    """Append the columns of other terms, (n,) or (n, k) each."""
    columns, blocks = matrix.columns, matrix.blocks
    for added in values.values():
        start, columns = columns.shape[1], np.column_stack([columns, added])
        blocks = (*blocks, slice(start, columns.shape[1]))
    return ModelMatrix(columns, (*matrix.terms, *values), blocks)


def _numbers(table: pd.DataFrame, name: str, data: Data) -> Array:
    """Values of a covariate in the rows that entered."""
    where = f"covariate {name!r}"
    if name not in table.columns:
        columns = [str(column) for column in table.columns]
        raise InputError(Fault(where, "no such column", nearest(name, columns)))
    if name in {*data.factors, *data.blocks}:
        raise InputError(Fault(where, "is a factor or the block already", "name it once"))
    try:
        values = np.asarray(table[name].to_numpy()[data.rows], dtype=float)
    except (TypeError, ValueError):
        raise InputError(Fault(where, "holds text", "a covariate is a column of numbers")) from None
    if not np.isfinite(values).all():
        row = int(data.rows[np.flatnonzero(~np.isfinite(values))[0]]) + 1
        raise InputError(Fault(f"row {row}, {where}", "is missing", "leave such rows out"))
    if not np.ptp(values):
        raise InputError(Fault(where, "never changes", "leave it out"))
    return values


def _check(data: Data, fixed: Factored) -> None:
    faults = []
    if not np.ptp(data.y):
        faults.append(Fault("response", "is the same in every row", "there is nothing to explain"))
    if not fixed.is_full:
        rule = "the rows cannot tell all terms apart"
        faults.append(Fault("model", rule, "leave interactions out: --model 1"))
    if faults:
        raise InputError(faults)
