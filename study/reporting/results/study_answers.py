"""The comparison of two studies, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from study.ground.canonical import Keyed
from study.statistics.analysis.anova_table import Effect
from study.statistics.surfaces.surface_optimum import FactorCombination, Goal, ResponseSpread

MATTERS = "holds in both: matters"
NO_DIFFERENCE = "holds in both: no practical difference"
DIFFERS = "differs"
ONE_CANNOT_TELL = "cannot tell in one"
NONE_CAN_TELL = "cannot tell in both"


@dataclass(frozen=True)
class Conclusion(Keyed):
    """One term of one response under both studies."""

    KEYS = "response factor=term unit scale conclusion holds end same_best found=of_each_study"

    response: str
    term: str
    unit: str
    #: One of the constants of this module; ``DIFFERS`` is followed by a colon and how.
    conclusion: str
    #: Whether the conclusion is the same in both; None where one of them cannot tell.
    holds: bool | None
    effects: tuple[Effect, Effect]
    ratio: bool = False
    #: {"lowest", "highest"}: end of the response that ``best`` names: the better one, or the
    #: highest where no end is better; None for interactions.
    end: str | None = None
    #: Whether some level leads in both, or lies within what matters of the leading one.
    same_best: bool | None = None
    best: tuple[str, str] = ("", "")

    @property
    def is_main(self) -> bool:
        """Whether this is the effect of one factor alone."""
        return ":" not in self.term

    @property
    def scale(self) -> str:
        """Either ``ratio`` or ``difference``."""
        return "ratio" if self.ratio else "difference"

    @property
    def of_each_study(self) -> list[dict[str, object]]:
        """The effect under each study, and the level that leads."""
        keys = ("practical", "p", "u_num", "ci95", "effect_over_u_num", "why")
        return [
            {"verdict": effect.strength, "effect": effect.range, "best": best}
            | {key: getattr(effect, key) for key in keys}
            for effect, best in zip(self.effects, self.best, strict=True)
        ]


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
        """Say from what to what it changed."""
        then, now = self.values
        if then is None:
            return f"{self.key}: {now}, not set before"
        if now is None:
            return f"{self.key}: {then} before, not set now"
        return f"{self.key}: from {then} to {now}"


@dataclass(frozen=True)
class OnlyInOne:
    """A response, term or level that only one study, named ``study``, has."""

    what: str
    name: str
    study: str
    why: str = ""


@dataclass(frozen=True)
class Beside(Keyed):
    """Everything that two studies say beside each other."""

    KEYS = "summary=lines changes conclusions only_in_one=only"

    names: tuple[str, str]
    changes: tuple[Change, ...]
    conclusions: tuple[Conclusion, ...]
    only: tuple[OnlyInOne, ...] = ()
    warnings: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()
    alphas: tuple[float, float] = (0.05, 0.05)

    @property
    def lines(self) -> list[str]:
        """The summary in plain spaces."""
        return [text.replace("\N{NO-BREAK SPACE}", " ") for text in self.summary]


@dataclass(frozen=True)
class Bound:
    """A limit of another response, as it was asked for."""

    response: str
    unit: str
    #: {1, -1}: 1 for at least, -1 for at most.
    sign: int
    value: float

    @property
    def words(self) -> str:
        """The limit as it is written."""
        sign = ">=" if self.sign > 0 else "<="
        return f"{self.response} {sign} {self.value:.4g} {self.unit}".strip()


@dataclass(frozen=True)
class Confirmed(Keyed):
    """What the true model says at a recommended setting."""

    KEYS = "settings values inside_interval=predicted keeps_limits=within_limits"

    settings: Mapping[str, str]
    #: Responses in their units, means over the blocks; NaN where the run has no answer.
    values: Mapping[str, float]
    #: Whether the response lies in the interval that was predicted.
    predicted: bool
    within_limits: bool


@dataclass(frozen=True)
class OtherChoice:
    """Levels that were not chosen, and the best value with them."""

    settings: Mapping[str, str]
    value: float


@dataclass(frozen=True)
class Recommendation(Keyed):
    """The best setting among choices."""

    KEYS = (
        "goal response unit settings held units value low high notes limits limits_hold "
        "at_end_of_range=at_end over_what_is_not_chosen=spread rivals confirmed"
    )

    goal: Goal
    response: str
    unit: str
    settings: Mapping[str, float | str]
    #: Settings that nobody recommends: of conditions, of unknowns, and those that were given.
    held: Mapping[str, float | str]
    units: Mapping[str, str]
    #: Prediction and its 95 % interval, in the response's unit; NaN while it is asked for.
    value: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")
    bounds: tuple[Bound, ...] = ()
    #: Prediction, and ends of its interval, of each of them.
    limited: tuple[tuple[float, float, float], ...] = ()
    #: {"surely", "predicted"}: whether the limits hold with the unfavourable ends of the intervals,
    #: or for the prediction alone; None without limits.
    limits_hold: str | None = None
    #: Choices that stand at an end of what was run: a better setting may lie beyond.
    at_end: tuple[str, ...] = ()
    #: What the factors that nobody chooses do there, over what was run of them.
    spread: ResponseSpread | None = None
    #: Other levels of the choices that are no numbers, and their best values, the best first.
    rivals: tuple[OtherChoice, ...] = ()
    confirmed: Confirmed | None = None
    notes: tuple[str, ...] = ()

    @property
    def limits(self) -> list[dict[str, object]]:
        """Every limit, and what is predicted of its response."""
        return [
            {"limit": bound.words, "response": bound.response, "unit": bound.unit}
            | dict(zip(("value", "low", "high"), predicted, strict=True))
            for bound, predicted in zip(self.bounds, self.limited, strict=True)
        ]


@dataclass(frozen=True)
class InputSet(Keyed):
    """What a measured curve says of one input."""

    KEYS = "name unit best low high open_low open_high verdict"

    name: str
    unit: str
    #: Setting of the best curve, and the ends of those that agree, in that unit.
    best: float
    low: float
    high: float
    #: Whether the settings that agree go on to the end of what was run, and maybe beyond.
    open_low: bool
    open_high: bool

    @property
    def verdict(self) -> str:
        """What is known of the input by itself."""
        if self.open_low and self.open_high:
            return "not determined"
        if self.open_low:
            return "has an upper end only"
        return "has a lower end only" if self.open_high else "determined"


@dataclass(frozen=True)
class Checked(Keyed):
    """A run of the true model at a setting of the set."""

    KEYS = "settings rms_N=rms agrees"

    settings: Mapping[str, str]
    #: What its curve misses of the measured one, root mean square in N; NaN without an answer.
    rms: float
    #: Whether it is no more than the limit.
    agrees: bool


#: how well the best curve of an inversion is the measured one: but for noise, perhaps, not at all
Agreement = Literal["agrees", "doubtful", "misses"]


@dataclass(frozen=True)
class Inverted(Keyed):
    """All inputs whose curve agrees with a measured one."""

    KEYS = (
        "sentence held units rows q2 members notes inputs combinations rms_N=rms limit_N=limit "
        "relative_rms=relative best_run end_runs"
    )

    inputs: tuple[InputSet, ...]
    #: What is determined where inputs by themselves are not.
    combinations: tuple[FactorCombination, ...]
    #: Known inputs, in the units of ``units``.
    held: Mapping[str, float | str]
    units: Mapping[str, str]
    #: What the best curve misses and what an agreeing one may miss, root mean square in N.
    rms: float
    limit: float
    #: ``rms`` over the root mean square of the measured force.
    relative: float
    #: Rows of the measured curve that were used.
    rows: int
    #: Of the emulator of the curves.
    q2: float
    members: tuple[Mapping[str, float], ...]
    best_run: Checked | None
    #: The true model where the least determined input is smallest and largest.
    end_runs: tuple[Checked, ...]
    notes: tuple[str, ...]
    #: Of the best curve with the measured one.
    agreement: Agreement = "agrees"

    @property
    def sentence(self) -> str:
        """What the curve determines, in a sentence."""
        if self.agreement == "misses":
            return "no curve inside of what was run is the measured one: use no input of it"
        doubtful = "it is doubtful that the model describes the curve; if it does, "
        return (doubtful if self.agreement == "doubtful" else "") + self._determined

    @property
    def _determined(self) -> str:
        loose = [item.name for item in self.inputs if item.open_low or item.open_high]
        if not loose:
            return "the curve determines every input that was asked for"
        if self.combinations:
            products = " and ".join(product.words for product in self.combinations)
            return (
                f"the curve does not determine {', '.join(loose)} alone; it determines {products}"
            )
        return f"the curve does not determine {', '.join(loose)} inside of what was run"
