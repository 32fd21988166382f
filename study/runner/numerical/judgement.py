"""What a refinement series says of every quantity: what ``study converge`` answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from study.analysis.convergence.grid_convergence import ConvergenceResult, grid_convergence
from study.canonical import plain
from study.design.study_file import Converge
from study.runner.numerical.curve_quantities import curve_values, quantity
from study.runner.numerical.error_sources import ErrorSource, one_table, other_sources, remarks
from study.runner.numerical.formal_order import FormalOrder
from study.runner.numerical.refinement import FEWEST, Budget, Level, Outlook, Series
from study.runner.numerical.sizes import representative_sizes, usable
from study.runner.numerical.solve_task import Solver
from study.setup.setup import Setup, Tables, problem_of

Values = Mapping[str, tuple[Sequence[float], str]]

#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7

#: a value of this part of the largest of its kind is nothing to be settled
_NOTHING = 1e-9


def judged(
    sizes: Sequence[float],
    values: Values,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of a series of at least three meshes.

    Parameters
    ----------
    sizes, values : sequence of float, mapping
        Mesh sizes; by the name of a quantity its values on these meshes, and their unit.
    formal : float or None
        Order that the elements promise; None where it is not known.
    tolerance : float
        Algebraic error as a fraction of the largest value.
    """
    return {
        name: grid_convergence(
            sizes, numbers, formal_order=formal, qoi=name, unit=unit,
            tolerance=tolerance * max(abs(v) for v in numbers),
        )
        for name, (numbers, unit) in values.items()
    }  # fmt: skip


def within(results: Mapping[str, ConvergenceResult], accuracy: float) -> dict[str, bool]:
    """Whether the uncertainty of each quantity is at most a fraction of its value.

    A series without an order has no GCI; it settles where thrice the range of its finest three
    meshes is small enough (Eca and Hoekstra 2014 for series that are noise).

    Parameters
    ----------
    results : mapping of str to ConvergenceResult
        By quantity.
    accuracy : float
        Fraction of the value on the finest mesh.
    """
    return {name: _bound(r) <= accuracy * abs(r.value[0]) + _NOTHING for name, r in results.items()}


def _bound(result: ConvergenceResult) -> float:
    if result.u_num is not None:
        return result.u_num
    finest = result.value[:3]
    return 3 * (max(finest) - min(finest))


def outlook(
    levels: Sequence[Level], setup: Setup, wanted: float | None, formal: float | None
) -> Outlook:
    """Whether every quantity has the accuracy that its problem asks for, else the size it takes.

    Parameters
    ----------
    levels, setup : sequence of Level, Setup
        Meshes so far, coarse to fine, and what is refined.
    wanted, formal : float or None
        Uncertainty over the value, and order that the elements promise.
    """
    kept, _ = usable(levels)
    if len(kept) < FEWEST or wanted is None:
        return Outlook(False)
    sizes = representative_sizes(kept, setup)
    results = judged(sizes, curve_values(kept), formal)
    sizes_needed = [size_needed(r, wanted) for r in results.values()]
    known = [size for size in sizes_needed if size is not None]
    return Outlook(all(within(results, wanted).values()), min(known, default=None))


def series_of(
    tables: Tables,
    spec: Converge,
    formal: FormalOrder,
    budget: Budget | None = None,
    levels_of: Mapping[str, str] | None = None,
) -> Series:
    """Make the series of a problem, from its own mesh size.

    Parameters
    ----------
    tables, spec : mapping, Converge
        Resolved problem; ratio, number of meshes, wanted accuracy.
    formal : FormalOrder
        What the elements promise.
    budget : Budget, optional
        When it must stop; by default where the memory ends.
    levels_of : mapping of str to str, optional
        Levels of the factors, where the problem is a cell.
    """
    from study.fem.mesh.mesher import mesh_size

    first = float(mesh_size(problem_of(tables).setup))
    seen = partial(outlook, setup=Setup.of(tables), wanted=spec.tolerance, formal=formal.order)
    return Series(tables, spec, first, budget or Budget(), seen, levels_of or {})


@dataclass(frozen=True)
class GivenMesh:
    """Value and uncertainty of the main quantity on the problem's own mesh."""

    mesh_size: float
    value: float
    u_num: float | None


@dataclass(frozen=True)
class SeriesJudgement:
    """What a refinement series says of every quantity.

    Parameters
    ----------
    main : ConvergenceResult
        Of the main quantity.
    quantities : mapping of str to ConvergenceResult
        Of every quantity; empty where there are no three meshes.
    formal : FormalOrder
        What the elements promise, and what limits it.
    accuracy : float or None
        Wanted uncertainty over the value; None where none was asked, or no order is known.
    levels, block : mapping of str to str, str or None
        Levels of the factors and block, where the series is that of a cell.
    given : GivenMesh or None
        The mesh as it was asked for.
    meshes, stopped : tuple of Level, str
        Every mesh of a problem, the finest first, and why no further one was solved.
    sources : tuple of ErrorSource
        Errors of mesh, load steps and solver side by side.
    """

    main: ConvergenceResult
    quantities: Mapping[str, ConvergenceResult]
    formal: FormalOrder
    accuracy: float | None = None
    levels: Mapping[str, str] = field(default_factory=dict)
    given: GivenMesh | None = None
    meshes: tuple[Level, ...] = ()
    stopped: str = ""
    sources: tuple[ErrorSource, ...] = ()
    block: str | None = None

    @property
    def settled(self) -> bool:
        """Whether every quantity has the wanted accuracy, or an uncertainty where none is asked."""
        return bool(self.quantities) and not self.unsettled

    @property
    def unsettled(self) -> list[str]:
        """Quantities without the wanted accuracy; without an uncertainty where none is asked."""
        if self.accuracy is None:
            return [name for name, r in self.quantities.items() if r.u_num is None]
        good = within(self.quantities, self.accuracy)
        return [name for name, ok in good.items() if not ok]

    @property
    def mesh_size_needed(self) -> float | None:
        """Mesh size that would have the wanted accuracy, in mm."""
        return None if self.accuracy is None else size_needed(self.main, self.accuracy)

    def warned(self, *said: str) -> SeriesJudgement:
        """Copy with further warnings, each once."""
        warnings = tuple(dict.fromkeys([*self.main.warnings, *said]))
        return replace(self, main=replace(self.main, warnings=warnings))

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge``: the keys of the main quantity, and all others."""
        of_problem = {
            "meshes": [level.to_json() for level in self.meshes],
            "stopped": self.stopped,
            "sources": [dict(plain(source)) for source in self.sources],
        }
        if not self.quantities:
            del of_problem["sources"]
        return {
            **self.main.to_json(),
            "quantities": {name: one.to_json() for name, one in self.quantities.items()},
            "accuracy": self.accuracy,
            "settled": self.settled,
            "given_mesh": None if self.given is None else vars(self.given),
            "mesh_size_needed": self.mesh_size_needed,
            "formal_reason": self.formal.why,
            "levels": dict(self.levels),
            **(of_problem if self.meshes else {"block": self.block}),
        }


def judge(series: Series, formal: FormalOrder, tolerance: float | None = None) -> SeriesJudgement:
    """Judge the series of a problem.

    Parameters
    ----------
    series : Series
        With its solved meshes.
    formal : FormalOrder
        What the elements promise.
    tolerance : float, optional
        Algebraic error of the main quantity, in its unit; by default that of the solver.
    """
    function, unit = quantity(series.spec.qoi)
    kept, said = usable(series.levels)
    facts = SeriesJudgement(
        inconclusive(
            series.spec.qoi,
            unit,
            [level.mesh_size_mm for level in kept],
            [function(level.curve) for level in kept],
            formal_order=formal.order,
        ),
        {},
        formal,
        levels=series.levels_of,
        meshes=tuple(reversed(series.levels)),
        stopped=series.stopped,
    )
    if len(kept) < FEWEST:
        return facts.warned(*said)
    fraction, coarsest = SOLVER_TOLERANCE, kept[0]
    if tolerance and (main := function(kept[-1].curve)):
        fraction = tolerance / abs(main)
    sizes = representative_sizes(kept, series.setup)
    results = judged(sizes, curve_values(kept), formal.order, fraction)
    found = combined(facts, series.spec.qoi, results, series.spec.tolerance, said)
    given = given_mesh(found.main)
    return replace(found, given=replace(given, mesh_size=coarsest.mesh_size_mm))


def with_sources(found: SeriesJudgement, series: Series, solve: Solver) -> SeriesJudgement:
    """Add the errors of load steps and solver on the coarsest mesh to those of the meshes.

    Parameters
    ----------
    found, series, solve : SeriesJudgement, Series, Solver
        Judgement of the series, which has an answer, and what solves it with other settings.
    """
    rows, said = other_sources(series.tables, series.good[0].mesh_size_mm, solve)
    table = one_table(found.quantities, rows)
    return replace(found, sources=table).warned(*said, *remarks(table))


def combined(
    facts: SeriesJudgement,
    qoi: str,
    results: Mapping[str, ConvergenceResult],
    accuracy: float | None,
    said: Sequence[str],
) -> SeriesJudgement:
    """Judgement of several judged quantities, all of which must settle.

    Parameters
    ----------
    facts : SeriesJudgement
        What is known of the series so far.
    qoi : str
        Main quantity, a key of ``results``.
    results : mapping of str to ConvergenceResult
        By quantity.
    accuracy : float or None
        Wanted uncertainty over the value.
    said : sequence of str
        Warnings so far.
    """
    main = results[qoi]
    found = replace(
        facts,
        main=replace(main, warnings=(*said, *main.warnings)),
        quantities=results,
        accuracy=accuracy,
        given=given_mesh(main),
    )
    if accuracy is None or not found.unsettled:
        return found.warned()
    return found.warned(f"not within {100 * accuracy:g} %: {', '.join(found.unsettled)}")


def given_mesh(result: ConvergenceResult) -> GivenMesh:
    """Value and uncertainty on the problem's own mesh, the coarsest of its series.

    Parameters
    ----------
    result : ConvergenceResult
        Of the main quantity; its last value is that of the problem's own mesh.
    """
    value, u = result.value[-1], None
    if (bound := result.bound_of(value)) is not None:
        u = bound
    elif result.u_num is not None:
        u = max(result.u_num, abs(value - result.value[0]))
    return GivenMesh(result.mesh_size[-1], value, u)


def inconclusive(
    qoi: str,
    unit: str,
    sizes: Sequence[float],
    values: Sequence[float],
    *,
    formal_order: float | None = None,
    u_num: float | None = None,
    verdict: str = "",
) -> ConvergenceResult:
    """Make the result of a series, coarse to fine, with too few meshes for an order.

    Parameters
    ----------
    qoi, unit : str
        Name and unit of the quantity.
    sizes, values : sequence of float
        Mesh sizes in mm, and the quantity on these meshes.
    formal_order, u_num : float, optional
        Order that the elements promise; uncertainty that is known otherwise, in ``unit``.
    verdict : str
        What to say; by default how many meshes there are.
    """
    usual = f"an order needs three meshes with an answer, there are {len(values)}"
    return ConvergenceResult(
        qoi=qoi,
        unit=unit,
        mesh_size=tuple(reversed(sizes)),
        value=tuple(reversed(values)),
        behaviour="inconclusive",
        observed_order=None,
        formal_order=formal_order,
        extrapolated=None,
        gci_fine=None,
        factor_of_safety=None,
        u_num=u_num,
        asymptotic_ratio=None,
        verdict=verdict or usual,
    )


def size_needed(result: ConvergenceResult, accuracy: float) -> float | None:
    """Mesh size whose uncertainty would be the wanted fraction of the value, by the order used.

    Parameters
    ----------
    result : ConvergenceResult
        Of one quantity.
    accuracy : float
        Fraction of the value.
    """
    if result.order_used is None or not result.u_num or result.extrapolated in (None, 0.0):
        return None
    allowed = accuracy * abs(result.extrapolated)
    return float(result.mesh_size[0] * (allowed / result.u_num) ** (1 / result.order_used))
