"""Two studies beside each other, as plain values that whoever holds both fills in."""

from __future__ import annotations

from dataclasses import dataclass


def document(beside: Beside) -> dict[str, object]:
    """Comparison as plain JSON.

    Parameters
    ----------
    beside : Beside
        Where an effect has no low or high end, its ``ci95`` becomes None.
    """
    from dataclasses import asdict

    rows = []
    for row in beside.conclusions:
        found = [asdict(f) for f in row.found]
        for one in found:
            ends = (one.pop("low"), one.pop("high"))
            one["ci95"] = None if None in ends else list(ends)
            one["effect_over_u_num"] = one.pop("over_u_num")
        rows.append(
            {
                "response": row.response, "factor": row.term, "unit": row.unit,
                "scale": "ratio" if row.ratio else "difference",
                "conclusion": row.conclusion, "holds": row.holds,
                "end": row.end or None, "same_best": row.same_best, "found": found,
            }
        )  # fmt: skip
    changed = [{"kind": c.kind, "key": c.key, "values": list(c.values)} for c in beside.changes]
    only = [
        {"what": o.what, "name": o.name, "study": beside.names[o.study], "why": o.why}
        for o in beside.only
    ]
    said = [text.replace("\N{NO-BREAK SPACE}", " ") for text in beside.summary]
    return {"summary": said, "changes": changed, "conclusions": rows, "only_in_one": only}


MATTERS = "holds in both: matters"
NO_DIFFERENCE = "holds in both: no practical difference"
DIFFERS = "differs"
ONE_CANNOT_TELL = "cannot tell in one"
NONE_CAN_TELL = "cannot tell in both"


@dataclass(frozen=True)
class Found:
    """What one of the two studies says of one term.

    Parameters
    ----------
    verdict : str
        As in the verdict table of that study.
    effect, low, high : float or None
        Largest difference and its 95 % interval: in the unit of the response, or ratios.
    practical : float or None
        Smallest difference that matters there, on the same scale.
    p, u_num, over_u_num : float or None
        The deciding p, numerical uncertainty, and the effect over it.
    best : str
        Level that leads (see ``Conclusion.end``), among the levels that both studies have.
    """

    verdict: str
    effect: float | None = None
    low: float | None = None
    high: float | None = None
    practical: float | None = None
    p: float | None = None
    u_num: float | None = None
    over_u_num: float | None = None
    best: str = ""
    why: str = ""


@dataclass(frozen=True)
class Conclusion:
    """One term of one response under both studies.

    Parameters
    ----------
    response, term, unit : str
        As in the analyses.
    conclusion : str
        One of the constants of this module; ``DIFFERS`` is followed by a colon and how.
    holds : bool or None
        Whether the conclusion is the same in both; None where one of them cannot tell.
    found : (Found, Found)
        What each study says.
    ratio : bool
        Whether effects are ratios.
    end : {"lowest", "highest", ""}
        End of the response that ``best`` names: the better one, or the highest where no end
        is better; empty for interactions.
    best_is_better : bool
        Whether that end is declared better.
    same_best : bool or None
        Whether some level leads in both, or lies within what matters of the leading one.
    """

    response: str
    term: str
    unit: str
    conclusion: str
    holds: bool | None
    found: tuple[Found, Found]
    ratio: bool = False
    end: str = ""
    best_is_better: bool = False
    same_best: bool | None = None

    @property
    def is_main(self) -> bool:
        """Whether this is the effect of one factor alone."""
        return ":" not in self.term


@dataclass(frozen=True)
class Change:
    """An input that the studies do not share; None where one of them does not set it.

    ``kind`` is ``"design"``, ``"measurements"``, ``"truth"``, ``"extent"``, ``"code"`` or
    ``"library"``.
    """

    kind: str
    key: str
    values: tuple[str | None, str | None]

    @property
    def sentence(self) -> str:
        """Say from what to what it changed.

        Examples
        --------
        >>> Change("design", "specimen.radius", ("25 mm", "26 mm")).sentence
        'specimen.radius: from 25 mm to 26 mm'
        >>> Change("design", "test.steps", (None, "20")).sentence
        'test.steps: 20, not set before'
        """
        then, now = self.values
        if then is None:
            return f"{self.key}: {now}, not set before"
        if now is None:
            return f"{self.key}: {then} before, not set now"
        return f"{self.key}: from {then} to {now}"


@dataclass(frozen=True)
class OnlyInOne:
    """A response, term or level that only the study ``study`` (0 or 1) has."""

    what: str
    name: str
    study: int
    why: str = ""


@dataclass(frozen=True)
class Beside:
    """Everything that two studies say beside each other.

    Parameters
    ----------
    names : (str, str)
        Of the studies.
    changes, conclusions, only
        What differs in their designs, what both conclude, and what one of them has alone.
    warnings, summary : tuple of str
        Sentences.
    alphas : (float, float)
        One minus the level of the intervals of each study.
    """

    names: tuple[str, str]
    changes: tuple[Change, ...]
    conclusions: tuple[Conclusion, ...]
    only: tuple[OnlyInOne, ...] = ()
    warnings: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()
    alphas: tuple[float, float] = (0.05, 0.05)
