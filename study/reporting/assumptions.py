"""Sentences about assumptions: what was tested, what came out, what if they are violated.

A test rejects or does not reject; data are never called "normal".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from study.reporting.data import ReportData
from study.reporting.facts import Facts
from study.reporting.text import THIN, clean, p_phrase, sentence, significant, term_name

Labels = Mapping[str, str] | None

WHAT_IF: tuple[tuple[str, str], ...] = (
    (
        "Residuals are far from normal",
        "p-values near the limit are uncertain; means and their differences stay unbiased. "
        "Verdicts rest on the effect against what matters, so few of them would change.",
    ),
    (
        "Cells scatter unequally",
        "one error term is too small for some cells and too large for others. With each effect "
        "tested against its own interaction with the blocks, only its own spread enters.",
    ),
    (
        "Correlations between levels differ (no sphericity)",
        "an uncorrected F rejects too often; the corrected p is the one to read.",
    ),
    (
        "Blocks and cells do not add up",
        "the effect depends on the block. The mean over blocks still answers for this family, "
        "but not for one specimen; the log of a positive response often helps.",
    ),
)


def rejects_normality(facts: Facts, alpha: float = 0.05) -> bool:
    """Whether Ryan-Joiner rejects: the simulated p decides, else the tabled one."""
    found = facts.normality or {}
    exact, printed = found.get("p_exact"), str(found.get("p_minitab") or "")
    if exact is not None:
        return bool(exact < alpha)
    number = printed.strip("<> ")
    if not number or printed.startswith(">"):
        return False
    return float(number) <= alpha if printed.startswith("<") else float(number) < alpha


def normality(facts: Facts, alpha: float = 0.05) -> str:
    """Ryan-Joiner in one sentence: rejected, not rejected or not applicable."""
    found = facts.normality
    if not found or found.get("rj") is None:
        reason = (found or {}).get("reason") or "there are no residuals to test"
        return sentence(f"Ryan-Joiner: not applicable, {reason}")
    exact, printed = found.get("p_exact"), str(found.get("p_minitab"))
    parts = [f"RJ = {found['rj']:.4f}", f"n = {found.get('n')}"]
    if exact is not None:
        parts.append(f"simulated {p_phrase(exact)}")
    parts.append("tabled p " + (printed if printed[0] in "<>" else f"= {printed}"))
    decision = "rejected" if rejects_normality(facts, alpha) else "not rejected"
    level = f"{100 * alpha:g}{THIN}%"
    return f"Ryan-Joiner: normality of the residuals is {decision} at {level} ({', '.join(parts)})."


def rejects(test: Mapping[str, Any], alpha: float = 0.05) -> bool:
    """Whether a test rejects; a Monte-Carlo p decides where there is one."""
    p = p_of(test)
    return p is not None and p < alpha


def p_of(test: Mapping[str, Any]) -> float | None:
    """Return the p of a test that decides: the Monte-Carlo one where there is one."""
    monte = test.get("p_monte_carlo")
    return monte if monte is not None else test.get("p")


def spread(test: str, found: Mapping[str, Any] | None, alpha: float = 0.05) -> str:
    """Bartlett or Levene in one sentence."""
    title = test.capitalize()
    if not found or found.get("statistic") is None:
        reason = (found or {}).get("reason") or "it was not run"
        return sentence(f"{title}: not applicable, {reason}")
    decision = "rejected" if rejects(found, alpha) else "not rejected"
    rough = ", approximate" if found.get("approximate") else ""
    df = found.get("df")
    shown = " and ".join(f"{part:g}" for part in df) if isinstance(df, list | tuple) else f"{df:g}"
    return (
        f"{title}: equal spread is {decision} at {100 * alpha:g}{THIN}% "
        f"(statistic {significant(found['statistic'])}, df {shown}, {p_phrase(p_of(found))}"
        f"{rough})."
    )


def additivity(found: Mapping[str, Any], data: ReportData) -> str:
    """Tukey's one-degree test in one sentence."""
    decision = "rejected" if rejects(found, data.alpha) else "not rejected"
    return (
        f"Tukey's one-degree test: that cells and {clean(data.block) or 'block'} simply add up is "
        f"{decision} (F = {significant(found.get('f'))}, {p_phrase(found.get('p'))})."
    )


def least_sphericity(facts: Facts) -> tuple[str, float] | None:
    """Term with the smallest Greenhouse-Geisser epsilon, and that epsilon."""
    known = {
        term: item["epsilon_gg"]
        for term, item in facts.sphericity.items()
        if item and item.get("epsilon_gg") is not None and item.get("df") != 0
    }
    if not known:
        return None
    term = min(known, key=lambda t: float(known[t]))
    return term, float(known[term])


def sphericity(facts: Facts, labels: Labels = None) -> str:
    """Say how far the correlations between cells are from what an uncorrected F assumes."""
    least = least_sphericity(facts)
    if least is None:
        return ""
    term, epsilon = least
    return (
        f"The smallest Greenhouse-Geisser epsilon is {epsilon:.2f} "
        f"({term_name(term, labels)}; 1 would be sphericity); every p is corrected by its own."
    )
