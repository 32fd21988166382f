"""The error-term ledger: which source of error is the best available, and what its p answers."""

from __future__ import annotations

from dataclasses import dataclass

POOLED, OWN, NONE = "pooled", "own", "none"

REMEDIES = (
    "no residual degrees of freedom, so no F: replicate runs that are set up anew (E0), score "
    "every cell on several measured specimens as blocks (E1), repeat with mesh seeds or "
    "resampled noise (E3, E2), or declare before looking that high-order interactions are "
    "negligible (E5: model = 2)"
)
NOISE_QUESTION = "is the effect larger than the noise in the measured data alone would give?"
ONE_CURVE = "one measured curve stands behind all resamples: nothing is said of specimens"
# statistics.md: below five seeds the scatter of the mesh is not known well enough
_SEEDS = 5


@dataclass(frozen=True)
class Situation:
    """What decides the source of error.

    Parameters
    ----------
    records : bool
        Whether the rows are runs of a deterministic study.
    block : str or None
        Name of the block, of several crossing ones joined by "and".
    replicated : bool
        Whether a cell holds more than one row.
    df_residual : int
        Residual degrees of freedom.
    full : bool
        Whether nothing was declared negligible.
    contrasts : int
        Degrees of freedom of the terms.
    sparse_ready : bool
        Whether Lenth's method applies.
    replicates : {"runs", "mesh-seeds", "noise"}
        What the rows of one cell are.
    largest_cell : int
        Rows of the largest cell.
    u_num : bool
        Whether the numerical uncertainty is known.
    """

    records: bool
    block: str | None
    replicated: bool
    df_residual: int
    full: bool
    contrasts: int
    sparse_ready: bool
    replicates: str = "runs"
    largest_cell: int = 1
    u_num: bool = False


@dataclass(frozen=True)
class Choice:
    """Source in the ledger, how it is computed, what its p answers, and what to beware of."""

    source: str
    how: str
    question: str
    reason: str
    cautions: tuple[str, ...] = ()


def method(error: str, block: str | None, records: bool, *, copies: bool = False) -> str:
    """Whether effects are tested against their own interactions with the blocks."""
    if block is None or error == "pooled":
        return POOLED
    # copies betray a study's table read from a CSV: pooling would add df and no variance
    return OWN if records or copies or error == "own" else POOLED


def own_choice(block: str, blocks: int, error: str) -> Choice:
    """E1 with every effect against its own interaction."""
    why = "asked for" if error == "own" else "cells of a study are scored on the same blocks"
    return Choice(
        "E1",
        OWN,
        f"would the ranking change with another {block}? (each effect against its own "
        f"interaction with {blocks} levels of {block}, Greenhouse-Geisser deciding)",
        why,
    )


def noise_choice(resamples: int) -> Choice:
    """E2 where cells fitted to one curve share its resampled noise."""
    return Choice(
        "E2",
        OWN,
        f"{NOISE_QUESTION} (each effect against its own scatter over {resamples} refits to "
        "resampled residuals, Greenhouse-Geisser deciding)",
        "cells hold refits to resampled measurement noise, the same for all cells of a curve",
        (ONE_CURVE,),
    )


def strata_choice(block: str, plots: str, between: tuple[str, ...], how: str) -> Choice:
    """E1 of a split plot: some factors vary between whole plots, the others within."""
    named = ", ".join(between)
    rest = "own interactions" if how == OWN else "the pooled scatter within whole plots"
    return Choice(
        "E1",
        how,
        f"would the ranking change with another {block}? ({named} against whole plots "
        f"({plots}), the others against {rest})",
        f"split plot: {named} is the same on the whole of a {plots}",
    )


def choose(s: Situation, error: str) -> Choice:
    """Best available source where effects are not tested against own interactions."""
    if s.df_residual > 0 and s.block is not None:
        return _pooled_blocks(s, error)
    if s.df_residual > 0 and s.replicated:
        return _replicates(s)
    if s.records and s.u_num and s.full:
        return Choice(
            "E4",
            NONE,
            "no p: is the effect resolved by the discretization? (effect over numerical "
            "uncertainty: resolved from 3, marginal from 1)",
            "no replicates and no blocks; the numerical uncertainty is known",
        )
    if s.df_residual > 0:
        return Choice(
            "E5",
            POOLED,
            "is the effect larger than the interactions declared negligible?",
            "assumption: the interactions left out of the model are zero",
        )
    if s.sparse_ready and s.contrasts >= 7:
        return Choice(
            "E6",
            NONE,
            "is the effect an outlier among the effects (effect sparsity)?",
            f"no replicates and no blocks; Lenth's method on {s.contrasts} contrasts",
        )
    return Choice(
        "E7",
        NONE,
        "no p: shares of variation and effects against the practical threshold",
        "no replicates, no blocks and nothing declared negligible",
    )


def _pooled_blocks(s: Situation, error: str) -> Choice:
    asked = error == "pooled"
    why = "asked for" if asked and not s.records else "independently run trials"
    if s.records:
        why = "asked for instead of own interactions"
    cautions: tuple[str, ...] = ()
    if s.records:
        cautions = (
            "pooled error on a study's cells: those that differ only in discretization add "
            "degrees of freedom and no variance, so p is far too small (use --error own)",
        )
    return Choice(
        "E1",
        POOLED,
        f"would the ranking change with another {s.block}? (interactions with {s.block} pooled)",
        why,
        cautions,
    )


def _replicates(s: Situation) -> Choice:
    extra = "" if s.full else "; interactions left out of the model are pooled with it"
    if s.replicates == "mesh-seeds":
        cautions = ["the bias of this mesh size is common to all seeds: read the effect over u_num"]
        if s.largest_cell < _SEEDS:
            cautions.append(
                f"{s.largest_cell} mesh seeds a cell: the scatter of the mesh needs {_SEEDS} or "
                "more to be known"
            )
        return Choice(
            "E3",
            POOLED,
            "is the effect larger than the mesh noise at this mesh size?",
            f"cells hold repeats with other mesh seeds{extra}",
            tuple(cautions),
        )
    if s.replicates == "noise":
        return Choice(
            "E2",
            POOLED,
            NOISE_QUESTION,
            f"cells hold refits to resampled measurement noise{extra}",
            (ONE_CURVE,),
        )
    return Choice(
        "E0",
        POOLED,
        "is the effect larger than the run-to-run scatter within a cell?",
        f"cells hold replicates{extra}",
    )
