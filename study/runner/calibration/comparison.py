"""Comparison of the constants that the tests of one material give, each fitted for itself."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.calibration.function import EvaluationFailed
from study.calibration.wald_test import ALPHA, USUAL_POWER, Agreement, agreement
from study.curve import Curve
from study.design.sections.calibration_design import CalibrationDesign
from study.errors import Fault, InputError, RefusedError
from study.material.registry import is_dimensionless
from study.record.record import plain
from study.runner.calibration.calibrate import calibrate
from study.runner.calibration.measured_tests import problem_of
from study.runner.calibration.result import CalibrationResult, parameters
from study.runner.calibration.score_test import linearized_fit
from study.runner.calibration.systematic_error import mesh_error, zero_error
from study.runner.fitting.fit_task import model
from study.runner.fitting.staged_fit import Progress
from study.runner.response import ConstantResponse, scale_of

#: difference of two curves over the larger force that is rounding
_ROUNDING = 1e-9

Verdict = Literal["differ", "agree", "undecided"]

#: slopes of the models at every test's own constants, or at those of all tests together
Form = Literal["wald", "score"]


@dataclass(frozen=True)
class Systematic:
    """Standard uncertainties of one test's constants that all its points share.

    Parameters
    ----------
    mesh, zero : ndarray, shape (p,)
        By the mesh and by the zero of the force, MPa (exponents plain).
    """

    mesh: Array
    zero: Array

    @property
    def covariance(self) -> Array:
        """Of both, shape (p, p)."""
        return np.outer(self.mesh, self.mesh) + np.outer(self.zero, self.zero)


@dataclass(frozen=True)
class Comparison:
    """Constants of every test for itself, and whether one material explains them all.

    Parameters
    ----------
    name, model : str
        Of the calibration and of the energy.
    fits : mapping of str to CalibrationResult
        By test, in the order of the file.
    test : Agreement
        Wald test of equality.
    systematic : mapping of str to Systematic
        By test: what moves its constants besides the scatter of its points.
    difference : float
        Share by which the moduli of one test are off in what the power is stated for.
    power : mapping of str to float
        By the test that is off: probability that the Wald test says so.
    detectable : mapping of str to float
        By the test that is off: share that is seen with a power of 80 %.
    form : {"wald", "score"}
        Whether slopes are those at each test's own constants, or at the common ones.
    """

    name: str
    model: str
    fits: Mapping[str, CalibrationResult]
    test: Agreement
    systematic: Mapping[str, Systematic]
    difference: float
    power: Mapping[str, float]
    detectable: Mapping[str, float]
    form: Form = "wald"

    @property
    def verdict(self) -> Verdict:
        """``undecided`` where no difference was seen that could have been missed."""
        if self.test.p < ALPHA:
            return "differ"
        return "agree" if min(self.power.values()) >= USUAL_POWER else "undecided"

    @property
    def least(self) -> str:
        """Test whose difference is the hardest to see."""
        return min(self.power, key=self.power.__getitem__)

    @property
    def mu0_spread(self) -> float:
        """Largest less smallest initial shear modulus of the tests, over their mean."""
        mu0 = [one.material.mu0 for one in self.fits.values() if one.material is not None]
        return float(np.ptp(mu0) / np.mean(mu0))

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        test, seen = self.test, f"mu0 spreads over {100 * self.mu0_spread:.3g} %"
        f = test.statistic / test.df
        at = ", slopes at the common constants" if self.form == "score" else ""
        wald = f"F({test.df}, {test.df_error:.4g}) = {f:.4g}, p = {test.p:.3g}{at}"
        off = f"moduli of {self.least} that are {100 * self.difference:.3g} % off"
        chance = f"{off} would be seen with a power of {self.power[self.least]:.3g}"
        says = {
            "differ": "the tests do not give the same constants",
            "agree": "one set of constants explains all tests",
            "undecided": "no difference was seen, but one that matters could have been missed",
        }
        return f"{says[self.verdict]}: {wald}; {seen}; {chance}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Cautions of every fit, which are those of the comparison as well."""
        said = [f"{label}: {w}" for label, one in self.fits.items() for w in one.warnings]
        vague = [
            f"{label}: the constants are not identifiable ({one.fit.reason}): the Wald test "
            "compares what the data hardly determine"
            for label, one in self.fits.items()
            if not one.fit.identifiable
        ]
        short = "alone it ended before its minimum"
        ended = [f"{k}: {short} ({f.message})" for k, f in self.fits.items() if not f.converged]
        return (*said, *vague, *ended)

    def to_json(self) -> dict[str, object]:
        """Document of ``study calibrate --by test --json``."""
        names = next(iter(self.fits.values())).fit.names
        error = np.sqrt(np.diag(self.test.covariance))
        content = {
            "name": self.name,
            "model": self.model,
            "by": "test",
            "verdict": self.verdict,
            "sentence": self.sentence,
            "groups": [
                {
                    "label": label,
                    "status": one.status,
                    "parameters": parameters(one.fit),
                    "correlation": one.fit.correlation,
                    "n": one.fit.n,
                    "identifiable": one.fit.identifiable,
                    "mesh_error": _shown(names, self.systematic[label].mesh),
                    "zero_error": _shown(names, self.systematic[label].zero),
                    "mu0": None if one.material is None else 1e3 * one.material.mu0,
                    "power": self.power[label],
                    "detectable": self.detectable[label],
                }
                for label, one in self.fits.items()
            ],
            "common": {
                name: {
                    "value": scale_of(name) * float(self.test.common[i]),
                    "unit": ConstantResponse(name).unit,
                    "standard_error": scale_of(name) * float(error[i]),
                }
                for i, name in enumerate(names)
            },
            "statistic": self.test.statistic,
            "f": self.test.statistic / self.test.df,
            "df": self.test.df,
            "df_error": self.test.df_error,
            "p": self.test.p,
            "p_chi_square": self.test.p_chi_square,
            "form": self.form,
            "mu0_spread": self.mu0_spread,
            "difference": self.difference,
            "warnings": list(self.warnings),
        }
        return cast("dict[str, object]", plain(content, "comparison", {}))


def compare(
    config: CalibrationDesign,
    root: Path,
    *,
    difference: float = 0.05,
    zero: float = 0.0,
    progress: Progress | None = None,
) -> Comparison:
    """Fit every test of a calibration for itself, and test whether the constants are equal.

    Parameters
    ----------
    config : CalibrationDesign
        The calibration; tests that are held out take no part.
    root : Path
        Data root.
    difference : float
        Share by which the moduli of one test are off in what the power is stated for.
    zero : float
        Standard uncertainty of the zero of a test's force, over its largest force.
    progress : callable, optional
        Gets every accepted iteration of every fit.

    Returns
    -------
    Comparison
        Fits, test and power.

    Raises
    ------
    InputError
        If there are no two tests to fit, or data are missing or malformed.
    RefusedError
        If a test alone does not determine the constants.
    """
    groups = _groups(config)
    fits, joint = _at_least_squares(config, groups, root, progress)
    if joint is None:
        _refuse_unconverged(fits)
    fits = _of_one_sign(groups, fits)
    compared, form = _compared(groups, root, fits, joint)
    if form == "wald":  # else slopes at the common constants are compared, which all tests have
        _refuse_unconverged(fits)
    systematic = {
        label: Systematic(
            mesh_error(one, root, fits[label], progress),
            zero_error(one, root, compared[label], zero),
        )
        for label, one in groups.items()
    }
    extra = [one.covariance for one in systematic.values()]
    test = agreement(list(compared.values()), extra)
    power: dict[str, float] = {}
    detectable: dict[str, float] = {}
    for i, label in enumerate(fits):
        unit = _off(test.common, next(iter(fits.values())).fit.names, i, len(fits))
        power[label], detectable[label] = test.power(difference * unit), test.detectable(unit)
    return Comparison(
        config.name, config.material.model, fits, test, systematic, difference, power,
        detectable, form,
    )  # fmt: skip


def _refuse_unconverged(fits: Mapping[str, CalibrationResult]) -> None:
    for label, one in fits.items():
        if not one.converged:
            mend = "take an energy with fewer constants, or give constants to start from"
            raise RefusedError(f"{label} alone gives no constants ({one.message}): {mend}")


def _compared(
    groups: Mapping[str, CalibrationDesign],
    root: Path,
    fits: Mapping[str, CalibrationResult],
    joint: Fit | None,
) -> tuple[dict[str, Fit], Form]:
    """Fits whose constants are compared: those of slopes at the common ones where these are had."""
    own = {label: one.fit for label, one in fits.items()}
    if joint is None or any(one.nuisance for one in own.values()):
        return own, "wald"
    try:
        linear = {k: linearized_fit(one, root, joint.constants()) for k, one in groups.items()}
    except EvaluationFailed:
        return own, "wald"
    sound = all(one.converged and (np.diag(one.covariance) > 0).all() for one in linear.values())
    return (linear, "score") if sound else (own, "wald")


def _at_least_squares(
    config: CalibrationDesign,
    groups: Mapping[str, CalibrationDesign],
    root: Path,
    progress: Progress | None,
) -> tuple[dict[str, CalibrationResult], Fit | None]:
    """Fit every test alone, and again from where the others and all together ended.

    The fit of all together comes second, where there are exponents and it converged.

    A sum of squares with exponents has several minima, and a fit that stopped at one of the
    higher ones would pass for another material.
    """
    fits = {label: calibrate(one, root, progress=progress) for label, one in groups.items()}
    if not any(is_dimensionless(name) for name in next(iter(fits.values())).fit.names):
        return fits, None  # linear in its moduli: one minimum
    begins, joint = [one.fit for one in fits.values() if one.converged], None
    with contextlib.suppress(InputError):
        whole = calibrate(config.pooled(), root, progress=progress)
        joint = whole.fit if whole.converged else None
    begins = begins if joint is None else [joint, *begins]
    for label, one in groups.items():
        own = fits[label].fit
        again = (
            calibrate(one, root, progress=progress, begin=other.constants())
            for other in begins
            if other is not own
        )
        found = [each for each in (fits[label], *again) if each.converged]
        fits[label] = min(found, key=lambda each: each.fit.rss, default=fits[label])
    return fits, joint


def _of_one_sign(
    groups: Mapping[str, CalibrationDesign], fits: Mapping[str, CalibrationResult]
) -> dict[str, CalibrationResult]:
    """Give exponents whose sign a test cannot tell the sign that the others find.

    The stress of Ogden's terms is even in the exponent where one principal stretch is the
    inverse of another: in simple shear and in planar tension. A fit ends at either sign.
    """
    names = next(iter(fits.values())).fit.names
    out = dict(fits)
    for k, name in enumerate(names):
        if not is_dimensionless(name):
            continue
        even = {label for label, one in fits.items() if _is_even(groups[label], one.fit, k)}
        telling = [label for label in fits if label not in even]
        sign = np.sign(fits[telling[0]].fit.values[k]) if telling else 1.0
        for label in even:
            if out[label].fit.values[k] * sign < 0:
                out[label] = replace(out[label], fit=_mirrored(out[label].fit, k))
    return out


def _is_even(config: CalibrationDesign, found: Fit, k: int) -> bool:
    """Whether the closed form of a test is the same for the other sign of one constant."""
    (test,) = config.tests
    problem = problem_of(test.tables)
    if problem.method != "closed-form":
        return False
    grids = [Curve(one.displacement_mm, one.force_N, time_s=one.time_s) for one in found.curves]
    predict = model(problem.method, problem.tables, grids, found.names)
    other = found.values.copy()
    other[k] *= -1
    try:
        pairs = zip(predict(found.values), predict(other), strict=True)
        return all(_is_same(one.force_N, two.force_N) for one, two in pairs)
    except EvaluationFailed:
        return False


def _is_same(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() <= _ROUNDING * np.abs(one).max())


def _mirrored(found: Fit, k: int) -> Fit:
    """Fit with the other sign of one constant."""
    sign = np.ones(found.values.size)
    sign[k] = -1
    ci95 = found.ci95.copy()
    ci95[k] = -ci95[k, ::-1]
    turned = np.outer(sign, sign)
    # slopes by that constant change their sign as well
    name = found.names[k]
    curves = tuple(
        replace(one, force_gradient={**one.force_gradient, name: -one.force_gradient[name]})
        for one in found.curves
    )
    return replace(
        found, values=sign * found.values, ci95=ci95, covariance=turned * found.covariance,
        correlation=turned * found.correlation, curves=curves,
    )  # fmt: skip


def _groups(config: CalibrationDesign) -> dict[str, CalibrationDesign]:
    """Calibration of every fitted test alone; only the bounds carry over."""
    fitted = [(i, test) for i, test in enumerate(config.tests) if test.role == "fit"]
    if len(fitted) < 2:
        mend = "give a second [[tests]] table with role = 'fit'"
        raise InputError(Fault("tests", "one test alone has nothing to be compared with", mend))
    stems, alone = [Path(test.file).stem for _, test in fitted], config.pooled()
    return {
        stem if stems.count(stem) == 1 else f"tests[{i}]": replace(alone, tests=(test,))
        for stem, (i, test) in zip(stems, fitted, strict=True)
    }


def _shown(names: tuple[str, ...], moved: Array) -> dict[str, float]:
    return {n: scale_of(n) * float(m) for n, m in zip(names, moved, strict=True)}


def _off(common: Array, names: tuple[str, ...], group: int, groups: int) -> Array:
    """Difference of one group: all its moduli are larger by their own size, no exponent is."""
    out = np.zeros((groups, len(names)))
    out[group] = [0 if is_dimensionless(n) else v for n, v in zip(names, common, strict=True)]
    return out
