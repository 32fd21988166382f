"""The cases of a study as their failures are looked at: by level, or by part of a range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from study.analysis.assumption.failed_cases import CaseFate, cause
from study.design.factors import settings_of
from study.design.spec import Design, Factor
from study.record.record import Record

#: equal parts of a range in whose stead its settings stand, where these are as good as all
#: different: no setting of a Latin hypercube stands twice, so that none could be blamed
PARTS = 4
#: most settings of a range that are levels of their own
GRID = 5


def fates(design: Design, records: Sequence[Record]) -> list[CaseFate]:
    """Collect the settings of every case that ended, and whether it failed.

    Parameters
    ----------
    design : Design
        Its factors say which settings are parts of a range.
    records : sequence of Record
        One a case that ended, with an answer or without.
    """
    parts = {
        factor.name: parts_of(factor)
        for factor in design.factors
        if factor.span is not None and len(factor.levels) > GRID
    }
    return [
        CaseFate(
            {name: parts.get(name, {}).get(level, level) for name, level in one.levels.items()},
            one.block or "",
            not one.converged,
            "" if one.converged else cause(one.status, one.message),
        )
        for one in records
    ]


def parts_of(factor: Factor) -> Mapping[str, str]:
    """Part of a range that the setting of every label lies in, by its ends in words.

    Parameters
    ----------
    factor : Factor
        Of any kind; the mapping is empty for one without a range.
    """
    span = factor.span
    if span is None:
        return {}
    ends = [span.at(k / PARTS) for k in range(PARTS + 1)]
    unit = f" {span.unit}" if span.unit else ""
    words = [f"{low:.4g} to {high:.4g}{unit}" for low, high in zip(ends, ends[1:], strict=False)]
    return {
        label: words[sum(value >= end for end in ends[1:-1])]
        for label, value in settings_of(factor).items()
    }
