"""The error-term ledger: which source of error is the best available, and what its p answers."""

from __future__ import annotations

from dataclasses import dataclass

from study.errors import Fault, InputError

POOLED, OWN, NONE = "pooled", "own", "none"

REMEDIES = (
    "no residual degrees of freedom, so no F: replicate runs that are set up anew (E0), score "
    "every cell on several measured specimens as blocks (E1), repeat with mesh seeds or "
    "resampled noise (E3, E2), or declare before looking that high-order interactions are "
    "negligible (E5: model = 2)"
)


@dataclass(frozen=True)
class Situation:
    """What decides the source of error."""

    records: bool
    block: str | None
    replicated: bool
    df_residual: int
    full: bool
    contrasts: int
    sparse_ready: bool
    tukey: float | None = None


@dataclass(frozen=True)
class Choice:
    """Source in the ledger, how it is computed, and what its p answers."""

    source: str
    how: str
    question: str
    reason: str


def method(error: str, block: str | None, records: bool, *, copies: bool = False) -> str:
    """Whether effects are tested against their own interactions with the blocks.

    Raises
    ------
    InputError
        For an unknown method, or ``own`` without a block.
    """
    if error not in ("auto", "pooled", "own"):
        raise InputError(Fault("error", f"must be auto, pooled or own, got {error!r}"))
    if error == "own" and block is None:
        raise InputError(
            Fault(
                "error",
                "'own' tests against interactions with the blocks, but no block is named",
                "name the replicated unit with --block",
            )
        )
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


def choose(s: Situation, error: str) -> Choice:
    """Best available source where effects are not tested against own interactions."""
    if s.df_residual > 0 and s.block is not None:
        why = "asked for instead of own interactions" if s.records else "independently run trials"
        return Choice(
            "E1",
            POOLED,
            f"would the ranking change with another {s.block}? (interactions with {s.block} "
            "pooled)",
            why,
        )
    if s.df_residual > 0 and s.replicated:
        extra = "" if s.full else "; interactions left out of the model are pooled with it"
        return Choice(
            "E0",
            POOLED,
            "is the effect larger than the run-to-run scatter within a cell?",
            f"cells hold replicates{extra}",
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
