"""The page that watches studies: those at work with their progress, finished ones side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from study.reporting.numbers import MISSING, duration, interval, p_value, ratio, significant
from study.reporting.output.page import _environment, policy_hash
from study.reporting.text import clean, name_of

if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True)
class Conclusion:
    """What a study found of one factor: a row of the verdict table of its report."""

    response: str
    factor: str
    verdict: str
    effect: float | None
    low: float | None
    high: float | None
    practical: float | None
    p: float | None
    is_ratio: bool = False
    unit: str = ""


@dataclass(frozen=True)
class Progress:
    """How far a runner is.

    Parameters
    ----------
    done, total : int
        Computations.
    counted : str
        The same in words.
    seconds_left : float or None
        None where it is not known.
    """

    done: int
    total: int
    counted: str
    seconds_left: float | None = None

    def to_json(self) -> dict[str, object]:
        """Plain values, for the script of the page."""
        left = "" if self.seconds_left is None else f", {duration(self.seconds_left)} left"
        return {"done": self.done, "total": self.total, "said": f"{self.counted}{left}"}


@dataclass(frozen=True)
class StudyState:
    """One study as its folders show it.

    Parameters
    ----------
    name, question : str
        As the user wrote them.
    factors : tuple of str
        Names of its factors.
    total, done, failed : int
        Cases.
    progress : Progress, optional
        Of the runner that is at work.
    page : str
        Address of its report; empty where there is none.
    conclusions : tuple of Conclusion
        Of its report.
    """

    name: str
    question: str
    factors: tuple[str, ...]
    total: int
    done: int
    failed: int
    progress: Progress | None = None
    page: str = ""
    conclusions: tuple[Conclusion, ...] = field(default=())

    @property
    def cases(self) -> str:
        """Cases in words."""
        missing = self.total - self.done - self.failed
        parts = [f"{self.done:,} of {self.total:,} done"]
        parts += [f"{self.failed:,} failed"] if self.failed else []
        parts += [f"{missing:,} missing"] if missing else []
        return ", ".join(parts)


def render_overview(
    states: Sequence[StudyState], *, factor: str = "", chosen: Sequence[str] = ()
) -> tuple[str, str]:
    """Return the page, and the policy that lets it run its own script and style alone.

    Parameters
    ----------
    states : sequence of StudyState
        Every study.
    factor : str
        The only factor that is compared; all where empty.
    chosen : sequence of str
        Names of the studies that stand side by side; all finished ones where empty.
    """
    script, style = _own("overview.js"), _own("style.css") + _own("overview.css")
    finished = [one for one in states if one.progress is None]
    compared = [one for one in finished if one.name in chosen] or finished
    factors = sorted({name for one in states for name in one.factors})
    text: str = _environment().get_template("overview.html.j2").render(
        running=[one for one in states if one.progress is not None],
        finished=[one for one in finished if not factor or factor in one.factors],
        factors=factors,
        factor=factor,
        chosen=[one.name for one in compared] if chosen else [],
        compared=beside(compared, factor),
        script=script,
        style=style,
        clean=clean,
    )  # fmt: skip
    policy = (
        f"default-src 'none'; style-src '{policy_hash(style)}'; "
        f"script-src '{policy_hash(script)}'; connect-src 'self'; img-src data:; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    )
    return text, policy


def beside(states: Sequence[StudyState], factor: str = "") -> Mapping[str, list[tuple[str, ...]]]:
    """Rows of every response: study, factor, verdict, difference, interval, limit, p.

    Parameters
    ----------
    states : sequence of StudyState
        Studies in the order of the rows.
    factor : str
        The only factor; all where empty.
    """
    found: dict[str, dict[str, list[tuple[str, ...]]]] = {}
    for one in states:
        for said in one.conclusions:
            if not factor or said.factor == factor:
                unit = f" ({said.unit})" if said.unit else ""
                rows = found.setdefault(f"{name_of(said.response)}{unit}", {})
                rows.setdefault(said.factor, []).append(_row(one.name, said))
    return {
        response: [row for rows in groups.values() for row in rows]
        for response, groups in found.items()
    }


def _row(study: str, said: Conclusion) -> tuple[str, ...]:
    shown = ratio if said.is_ratio else significant
    ends = MISSING
    if said.low is not None and said.high is not None:
        ends = interval(said.low, said.high)
    return (
        clean(study), name_of(said.factor), said.verdict, shown(said.effect), ends,
        shown(said.practical), p_value(said.p),
    )  # fmt: skip


def _own(name: str) -> Markup:
    """Text of a file of this package, which holds no word of a user."""
    from importlib.resources import files

    from markupsafe import Markup

    text = (files("study.reporting") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704
