"""Words that a newcomer has not met, explained where they stand."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

#: term, as it is written, and what it means
TERMS: dict[str, str] = {
    "block": "What was measured several times under every condition: a specimen, a phantom, a "
    "batch. Every combination of the factors is computed for each block.",
    "cell": "One combination of the levels of all factors.",
    "pp": "Percentage points: from 2 % to 3 % is 1 pp.",
    "U": "Bound of the numerical error of a difference, from finer meshes. It is added to both "
    "ends of the interval before that is held against what matters.",
    "matters from": "The smallest difference that matters in practice, as the design file says.",
    "largest difference": "Between the two levels that are farthest apart, on average over the "
    "other factors.",
    "p": "How often chance alone would give an effect at least this large if there were none. "
    "It never decides alone.",
    "p (Holm)": "p adjusted for the number of terms tested in this table (Holm 1979).",
    "p corrected": "p with the degrees of freedom corrected for unequal covariances.",
    "GG epsilon": "Greenhouse-Geisser epsilon: 1 where all differences between levels scatter "
    "alike over the blocks, smaller where they do not; it multiplies the degrees of freedom.",
    "Greenhouse-Geisser": "A correction of the degrees of freedom for differences between levels "
    "that scatter unequally over the blocks (Greenhouse and Geisser 1959).",
    "Welch-Box": "A test for groups of blocks that scatter unequally: every group keeps its own "
    "variance (Welch 1938, Box 1954).",
    "omega squared": "Estimated share of the variance that a term explains in the population.",
    "partial eta squared": "Sum of squares of a term over itself plus its error.",
    "share": "Part of the total sum of squares.",
    "df": "Degrees of freedom: independent comparisons in a term.",
    "F": "Variance of a term over the variance of its error.",
    "E0": "Error term: independent replicates within the cells.",
    "E1": "Error term: the blocks; each effect is compared with how it differs between blocks.",
    "E2": "Error term: measurement noise, by refits to resampled curves.",
    "E3": "Error term: new meshes of the same size.",
    "E4": "Error term: none; the numerical uncertainty alone.",
    "E5": "Error term: interactions that were declared to be zero.",
    "E6": "Error term: Lenth's, from the smallest effects of an unreplicated design.",
    "E7": "Error term: none, so no p.",
    "simple effect": "Difference of two levels of a factor at one setting of the others.",
    "component": "What an interaction adds to the effects of its factors alone.",
    "Ryan-Joiner": "A test of normality: the correlation of a normal probability plot.",
    "V&V 20": "The standard ASME V&V 20-2009 on verification and validation of simulations.",
}
_FOUND_IN_TEXT = [
    term for term in TERMS if term not in ("p", "F", "df", "U", "share", "matters from", "block")
]
_PATTERN = re.compile(
    r"(?<![\w-])(?:" + "|".join(map(re.escape, sorted(_FOUND_IN_TEXT, key=len, reverse=True)))
    + r")(?![\w-])"
)  # fmt: skip


def glossed(text: str) -> Markup:
    """Escape a text, with the first of each term that the glossary holds explained on hover.

    Parameters
    ----------
    text : str
        Plain text. Terms that are short or common words, such as ``p`` and ``block``, stay as
        they are.

    Examples
    --------
    >>> print(glossed("1 pp < 2 pp"))
    1 <abbr title="Percentage points: from 2 % to 3 % is 1 pp.">pp</abbr> &lt; 2 pp
    """
    seen: set[str] = set()
    parts, last = [], 0
    for found in _PATTERN.finditer(text):
        if found[0] in seen:
            continue
        seen.add(found[0])
        parts += [escape(text[last : found.start()]), explained(found[0])]
        last = found.end()
    return Markup("").join([*parts, escape(text[last:])])


def explained(term: str) -> Markup:
    """Escape one word, explained on hover where the glossary holds it.

    Parameters
    ----------
    term : str
        Written exactly as in ``TERMS``; any other text is only escaped.
    """
    meaning = TERMS.get(term)
    if meaning is None:
        return escape(term)
    return Markup('<abbr title="{}">{}</abbr>').format(meaning, term)
