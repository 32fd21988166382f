"""Comparison of the constants that the tests of one material give, each fitted for itself."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Json, Keyed, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.units import p_phrase
from study.mechanics.calibration.fit import Fit, fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.identifiability import fitted_rows
from study.mechanics.calibration.lack_of_fit import (
    USUAL_POWER,
    WALD_ALPHA,
    FitAgreement,
    agreement,
    akaike_weights,
)
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.material.material import is_dimensionless, unit_shown
from study.simulation.calibration.calibrate_tests import calibrate
from study.simulation.calibration.calibration_file import CalibrationDesign
from study.simulation.calibration.calibration_result import CalibrationResult, parameters
from study.simulation.calibration.measured_tests import in_order, parts_of, read_tests
from study.simulation.fit_task import OPEN, Progress, fitted_model, models_of
from study.simulation.job import fitted_test
from study.simulation.response import in_shown_units, scale_of

# Constants of one test to first order around those of all tests: one Gauss-Newton step from the
# common estimate (Rao 1948, Proc. Camb. Phil. Soc. 44, 50), where Wald's statistic rejects too
# often.


def linearized_fit(config: CalibrationDesign, root: Path, common: Mapping[str, float]) -> Fit:
    """Fit one test with the slopes at the constants that all tests share. Units: common MPa."""
    names, center = tuple(common), np.array(list(common.values()), float)
    measured = in_order(read_tests(config.tests, root)[0])
    parts = parts_of(config.tests, measured)
    # force and gradient at the measured points, where a line is all that is needed
    base = [
        Curve(
            d := measured_curve.displacement_mm,
            curve.force_at(d),
            force_gradient=dict(zip(names, curve.gradients_at(names, d).T, strict=True)),
            time_s=curve.time_s,
        )
        for part, model in zip(parts, models_of(parts, names), strict=True)
        for curve, measured_curve in zip(model(center), part.curves, strict=True)
    ]

    def predict(values: Array) -> list[Curve]:
        moved = dict(zip(names, values - center, strict=True))
        return [
            replace(c, force_N=c.force_N + sum(moved[n] * c.force_gradient[n] for n in names))
            for c in base
        ]

    return with_serial_correlation(fit(predict, measured, names, center), measured)


# Errors that all points of one test share, such as a load cell's zero and the mesh, as changes of
# the constants.

#: of the mesh sizes of neighboring names, and of the meshes whose constants are compared
_RATIO = 1.5


def zero_error(config: CalibrationDesign, root: Path, fit: Fit, zero: float) -> Array:
    """Change of the constants by a shift of all forces of one test. Shapes: returns (p,), MPa."""
    curves = in_order(read_tests(config.tests, root)[0])
    slopes, weights, _ = fitted_rows(fit, curves)
    jacobian = weights[:, None] * slopes
    shifts = np.repeat(
        [zero * np.abs(m.curve.force_N).max() for m in curves],
        [np.count_nonzero(m.weights) for m in curves],
    )
    scale = np.linalg.norm(jacobian, axis=0)
    shift = np.linalg.lstsq(jacobian / scale, weights * shifts, rcond=None)[0]
    return np.asarray(shift / scale)


def mesh_error(
    config: CalibrationDesign,
    root: Path,
    result: CalibrationResult,
    progress: Progress | None = None,
) -> Array:
    """Error that the mesh leaves in the constants of one test, from a second, coarser mesh.

    Constants move with the first power of the mesh size where an edge or a bonded corner makes
    the stress singular, so that of the change between two meshes of ratio r, change / (r - 1) is
    left; for smooth solutions that is more than there is.

    Shapes: returns (p,), MPa.
    """
    (test,) = config.tests
    if fitted_test("auto", test.problem).method != "inverse-fem":
        return np.zeros_like(result.fit.values)
    coarser = test.problem.model.coarser(_RATIO)
    if coarser is None:
        mend = 'write mesh = "medium" or "fine" in [model]'
        raise InputError(Fault("model.mesh", "none is coarser, to tell its error from", mend))
    coarse = replace(test, problem=replace(test.problem, model=coarser))
    # from the same minimum: the distance to another one is no error of the mesh
    other = calibrate(
        replace(config, tests=(coarse,)), root, progress=progress, begin=result.fit.constants()
    )
    if not other.converged:
        raise RefusedError("a coarser mesh gives no constants to tell the mesh's error from: "
                           "take a finer mesh")  # fmt: skip
    return np.asarray((result.fit.values - other.fit.values) / (_RATIO - 1))


#: difference of two curves over the larger force that is rounding
_ROUNDING = 1e-9

Verdict = Literal["differ", "agree", "undecided"]
#: slopes of the models at every test's own constants, or at those of all tests together
Form = Literal["wald", "score"]


@dataclass(frozen=True)
class ModelComparison(Keyed):
    """Constants of every test for itself, and whether one material explains them all."""

    KEYS = (
        "name model by=form verdict sentence groups=fits common=test statistic=test.statistic "
        "f=test.statistic df=test.df df_error=test.df_error p=test.p "
        "p_chi_square=test.p_chi_square form mu0_spread difference warnings"
    )

    #: Of the calibration and of the energy.
    name: str
    model: str
    #: By test, in the order of the file.
    fits: Mapping[str, CalibrationResult]
    test: FitAgreement
    #: By test: standard uncertainties of its constants that all its points share, by the mesh and
    #: by the zero of the force; shape (p,), MPa (exponents plain).
    systematic: Mapping[str, tuple[Array, Array]]
    #: Relative error of the moduli of one test for which the power is stated.
    difference: float
    #: By the deviating test: probability that the Wald test detects it.
    power: Mapping[str, float]
    #: By the deviating test: relative error detected with a power of 80 %.
    detectable: Mapping[str, float]
    #: {"wald", "score"}: whether slopes are those at each test's own constants, or at the common
    #: ones.
    form: Form = "wald"

    @property
    def verdict(self) -> Verdict:
        """``undecided`` where no difference was seen that could have been missed."""
        if self.test.p < WALD_ALPHA:
            return "differ"
        return "agree" if min(self.power.values()) >= USUAL_POWER else "undecided"

    @property
    def least(self) -> str:
        """Test whose difference is the hardest to see."""
        return min(self.power, key=self.power.__getitem__)

    @property
    def mu0_spread(self) -> float:
        """Largest less smallest initial shear modulus of the tests, over their mean."""
        mu0 = [result.material.mu0 for result in self.fits.values() if result.material is not None]
        return float(np.ptp(mu0) / np.mean(mu0))

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        test, seen = self.test, f"mu0 spreads over {100 * self.mu0_spread:.3g} %"
        f = test.statistic / test.df
        at = ", slopes at the common constants" if self.form == "score" else ""
        wald = f"F({test.df}, {test.df_error:.4g}) = {f:.4g}, {p_phrase(test.p)}{at}"
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
        cautions = [f"{label}: {w}" for label, result in self.fits.items() for w in result.warnings]
        vague = [
            f"{label}: the constants are not identifiable ({result.fit.reason}): the Wald test "
            "compares what the data hardly determine"
            for label, result in self.fits.items()
            if not result.fit.identifiable
        ]
        ended = [
            f"{label}: alone it ended before its minimum ({result.message})"
            for label, result in self.fits.items()
            if not result.converged
        ]
        return (*cautions, *vague, *ended)

    def to_json(self) -> dict[str, Json]:
        """Document of ``study calibrate --by test --json``; moduli in kPa, exponents plain."""
        names = next(iter(self.fits.values())).fit.names
        error = np.sqrt(np.diag(self.test.covariance))
        shown = {
            "by": "test",
            "groups": [
                {
                    "label": label,
                    "status": result.status,
                    "parameters": parameters(result.fit),
                    "correlation": result.fit.correlation,
                    "n": result.fit.n,
                    "identifiable": result.fit.identifiable,
                    "mesh_error": in_shown_units(names, self.systematic[label][0]),
                    "zero_error": in_shown_units(names, self.systematic[label][1]),
                    "mu0": None if result.material is None else 1e3 * result.material.mu0,
                    "power": self.power[label],
                    "detectable": self.detectable[label],
                }
                for label, result in self.fits.items()
            ],
            "common": {
                name: {
                    "value": scale_of(name) * float(self.test.common[i]),
                    "unit": unit_shown(name),
                    "standard_error": scale_of(name) * float(error[i]),
                }
                for i, name in enumerate(names)
            },
            "f": self.test.statistic / self.test.df,
        }
        return plain({**self.keyed(), **shown})


def compare(
    config: CalibrationDesign,
    root: Path,
    *,
    difference: float = 0.05,
    zero: float = 0.0,
    progress: Progress | None = None,
) -> ModelComparison:
    """Fit every test of a calibration for itself, and test whether the constants are equal."""
    fitted = [(i, test) for i, test in enumerate(config.tests) if test.role == "fit"]
    if len(fitted) < 2:
        mend = "give a second [[tests]] table with role = 'fit'"
        raise InputError(Fault("tests", "one test alone has nothing to be compared with", mend))
    stems, alone = [Path(test.file).stem for _, test in fitted], config.pooled()
    groups = {
        stem if stems.count(stem) == 1 else f"tests[{i}]": replace(alone, tests=(test,))
        for stem, (i, test) in zip(stems, fitted, strict=True)
    }
    fits, joint = _at_least_squares(config, groups, root, progress)
    if joint is None:
        _refuse_unconverged(fits)
    fits = _of_one_sign(groups, fits)
    compared, form = _compared(groups, root, fits, joint)
    if form == "wald":  # else slopes at the common constants are compared, which all tests have
        _refuse_unconverged(fits)
    systematic = {
        label: (
            mesh_error(group, root, fits[label], progress),
            zero_error(group, root, compared[label], zero),
        )
        for label, group in groups.items()
    }
    extra = [np.outer(mesh, mesh) + np.outer(zero, zero) for mesh, zero in systematic.values()]
    test = agreement(list(compared.values()), extra)
    # all moduli of one test are larger by their own size, no exponent is
    is_modulus = [not is_dimensionless(n) for n in next(iter(fits.values())).fit.names]
    one_off = np.eye(len(fits))[..., None] * np.where(is_modulus, test.common, 0.0)
    units = dict(zip(fits, one_off, strict=True))
    power = {label: test.power(difference * unit) for label, unit in units.items()}
    detectable = {label: test.detectable(unit) for label, unit in units.items()}
    return ModelComparison(
        config.name, config.material.model, fits, test, systematic, difference, power,
        detectable, form,
    )  # fmt: skip


def _refuse_unconverged(fits: Mapping[str, CalibrationResult]) -> None:
    for label, result in fits.items():
        if not result.converged:
            mend = "take an energy with fewer constants, or give constants to start from"
            raise RefusedError(f"{label} alone gives no constants ({result.message}): {mend}")


def _compared(
    groups: Mapping[str, CalibrationDesign],
    root: Path,
    fits: Mapping[str, CalibrationResult],
    joint: Fit | None,
) -> tuple[dict[str, Fit], Form]:
    """Fits whose constants are compared: those of slopes at the common ones where these are had."""
    fits_alone = {label: result.fit for label, result in fits.items()}
    if joint is None or any(fit.nuisance for fit in fits_alone.values()):
        return fits_alone, "wald"
    try:
        linear = {k: linearized_fit(g, root, joint.constants()) for k, g in groups.items()}
    except EvaluationFailed:
        return fits_alone, "wald"
    sound = all(g.converged and (np.diag(g.covariance) > 0).all() for g in linear.values())
    return (linear, "score") if sound else (fits_alone, "wald")


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
    fits = {label: calibrate(group, root, progress=progress) for label, group in groups.items()}
    if not any(is_dimensionless(name) for name in next(iter(fits.values())).fit.names):
        return fits, None  # linear in its moduli: one minimum
    begins, joint = [result.fit for result in fits.values() if result.converged], None
    with contextlib.suppress(InputError):
        whole = calibrate(config.pooled(), root, progress=progress)
        joint = whole.fit if whole.converged else None
    begins = begins if joint is None else [joint, *begins]
    for label, group in groups.items():
        first = fits[label].fit
        again = (
            calibrate(group, root, progress=progress, begin=other.constants())
            for other in begins
            if other is not first
        )
        candidates = [each for each in (fits[label], *again) if each.converged]
        fits[label] = min(candidates, key=lambda each: each.fit.rss, default=fits[label])
    return fits, joint


def _of_one_sign(
    groups: Mapping[str, CalibrationDesign], fits: Mapping[str, CalibrationResult]
) -> dict[str, CalibrationResult]:
    """Give exponents whose sign a test cannot tell the sign that the others find."""
    # The stress of Ogden's terms is even in the exponent where one principal stretch is the inverse
    # of another: in simple shear and in planar tension. A fit ends at either sign.
    names = next(iter(fits.values())).fit.names
    out = dict(fits)
    for k, name in enumerate(names):
        if not is_dimensionless(name):
            continue
        even = {label for label, result in fits.items() if _is_even(groups[label], result.fit, k)}
        telling = [label for label in fits if label not in even]
        sign = np.sign(fits[telling[0]].fit.values[k]) if telling else 1.0
        for label in even:
            if out[label].fit.values[k] * sign < 0:
                out[label] = replace(out[label], fit=_mirrored(out[label].fit, k))
    return out


def _is_even(config: CalibrationDesign, fit: Fit, k: int) -> bool:
    """Whether the closed form of a test is the same for the other sign of one constant."""
    (test,) = config.tests
    fitted = fitted_test("auto", test.problem)
    if fitted.method != "closed-form":
        return False
    grids = [Curve(c.displacement_mm, c.force_N, time_s=c.time_s) for c in fit.curves]
    predict = fitted_model(fitted.method, fitted.problem, grids, fit.names)
    other = fit.values.copy()
    other[k] *= -1
    try:
        pairs = zip(predict(fit.values), predict(other), strict=True)
        return all(
            bool(np.abs(a.force_N - b.force_N).max() <= _ROUNDING * np.abs(a.force_N).max())
            for a, b in pairs
        )
    except EvaluationFailed:
        return False


def _mirrored(fit: Fit, k: int) -> Fit:
    """Fit with the other sign of one constant."""
    sign = np.ones(fit.values.size)
    sign[k] = -1
    ci95 = fit.ci95.copy()
    ci95[k] = -ci95[k, ::-1]
    turned = np.outer(sign, sign)
    # slopes by that constant change their sign as well
    name = fit.names[k]
    curves = tuple(
        replace(curve, force_gradient={**curve.force_gradient, name: -curve.force_gradient[name]})
        for curve in fit.curves
    )
    return replace(
        fit, values=sign * fit.values, ci95=ci95, covariance=turned * fit.covariance,
        correlation=turned * fit.correlation, curves=curves,
    )  # fmt: skip


# Choice between energies: each is fitted to the same tests and weighed by AICc.

#: energies compared: name, order, label
CANDIDATES = (
    ("neo-hookean", None, "neo-hookean"),
    ("mooney-rivlin", None, "mooney-rivlin"),
    ("reduced-polynomial", 2, "reduced-polynomial-2"),
    ("reduced-polynomial", 3, "reduced-polynomial-3"),
    ("ogden", 1, "ogden-1"),
    ("ogden", 2, "ogden-2"),
    ("ogden", 3, "ogden-3"),
    ("arruda-boyce", None, "arruda-boyce"),
    ("gent", None, "gent"),
    ("fung", None, "fung"),
    ("veronda-westmann", None, "veronda-westmann"),
    ("van-der-waals", None, "van-der-waals"),
    ("extended-tube", None, "extended-tube"),
)
#: compared besides where the sides are free to follow Poisson's ratio, in closed-form tests
FOAMS = (("ogden-hill", 1, "ogden-hill-1"), ("ogden-hill", 2, "ogden-hill-2"))


#: error of held-out tests over the least one, up to which an energy predicts as well
_PREDICTS = 1.25


@dataclass(frozen=True)
class EnergyChoice:
    """Fits of several energies to the same tests."""

    #: By label, in the order of the candidates.
    fits: Mapping[str, CalibrationResult]
    #: Akaike weights among those that may be chosen.
    weights: Mapping[str, float]
    #: Energies without an answer, and why.
    failures: Mapping[str, str]

    @property
    def alike(self) -> tuple[str, ...]:
        """Energies that the tests cannot tell apart, the fewest constants first.

        Of those that may be chosen: where tests are held out, those that predict them as well as
        any; of these, an AICc within 6 of the least.
        """
        errors = {label: _held_out_error(self.fits[label]) for label in self.weights}
        least = min((e for e in errors.values() if e is not None), default=None)
        eligible = [
            label
            for label, error in errors.items()
            if least is None or (error is not None and error <= _PREDICTS * least)
        ]
        aicc = {label: self.fits[label].fit.aicc for label in eligible}
        near = [label for label in eligible if aicc[label] - min(aicc.values()) < OPEN]
        return tuple(sorted(near, key=lambda name: (len(self.fits[name].fit.names), aicc[name])))

    @property
    def best(self) -> str | None:
        """Label of the simplest energy that no other is told to be better than."""
        return next(iter(self.alike), None)

    @property
    def better(self) -> str | None:
        """Label of the energy that is told to be better, though its constants are not determined.

        Of those that describe the rows: the least AICc, where that is 6 below the chosen one's.
        """
        aicc = {n: f.fit.aicc for n, f in self.fits.items() if f.adequacy.describes}
        least = min(aicc, key=aicc.__getitem__, default=None)
        if least is None or self.best is None or self.best == least or least in self.weights:
            return None
        return least if aicc[self.best] - aicc[least] > OPEN else None

    @property
    def sentence(self) -> str:
        """The choice in words, with what it does not say."""
        if self.best is None:
            why = "; ".join(f"{label}: {_unfit(result)}" for label, result in self.fits.items())
            return f"no energy can be recommended: {why}" if why else "no energy could be fitted"
        held = _held_out_error(self.fits[self.best])
        by = "AICc prefers"
        if held is not None:
            by = f"held-out tests ({held:.3g} % RMS error) and AICc prefer"
        text = f"{by} {self.best} (weight {self.weights[self.best]:.3g})"
        others = self.alike[1:]
        if others:
            listed = ", ".join(others)
            text += f", the fewest constants among energies that cannot be told apart ({listed})"
        if self.better:
            lower = self.fits[self.best].fit.aicc - self.fits[self.better].fit.aicc
            text += f"; {self.better} describes the rows better (AICc lower by {lower:.3g}), but "
            text += f"is not chosen: {_unfit(self.fits[self.better])}"
        return f"{text}; it compares energies on these data only, not the constants' truth"

    def to_json(self) -> dict[str, Json]:
        """Table of the energies."""
        best = min((f.fit.aicc for f in self.fits.values()), default=0.0)
        content = {
            "best": self.best,
            "cannot_be_told_apart": self.alike,
            "sentence": self.sentence,
            "energies": [
                {
                    "energy": label,
                    "status": result.status,
                    "constants": len(result.fit.names),
                    "aicc": result.fit.aicc,
                    "delta_aicc": result.fit.aicc - best,
                    "weight": self.weights.get(label),
                    "rss": result.fit.rss,
                    "mu0": None if result.material is None else 1e3 * result.material.mu0,
                    "identifiable": result.fit.identifiable,
                    "reason": result.fit.reason,
                    "not_chosen_because": _unfit(result),
                    "verdict": result.adequacy.verdict,
                    "stable": result.stable,
                    "held_out": _held_out_errors(result),
                }
                for label, result in self.fits.items()
            ],
            "failures": self.failures,
        }
        return plain(content)


def _held_out_errors(result: CalibrationResult) -> list[object]:
    held = [curve for curve in result.curves if curve.role == "held-out"]
    return [curve.as_dict()["relative_rms_force_error"] for curve in held]


def _held_out_error(result: CalibrationResult) -> float | None:
    """Root mean square of the relative errors of held-out tests, %; None where none is."""
    errors = _held_out_errors(result)
    if not errors:
        return None
    return float(np.sqrt(np.mean([np.inf if e is None else float(str(e)) ** 2 for e in errors])))


def _unfit(result: CalibrationResult) -> str:
    """Why an energy may not be chosen; empty where it may."""
    held = [
        n for n, e in zip(result.fit.names, result.fit.standard_error, strict=True) if not e > 0
    ]
    if held:
        return f"{', '.join(held)} ended at a bound"
    if not result.fit.identifiable:
        return f"not identifiable: {result.fit.reason}"
    return "" if result.adequacy.describes else result.adequacy.sentence


def choose(
    config: CalibrationDesign, root: Path, *, progress: Progress | None = None
) -> EnergyChoice:
    """Fit every candidate to the tests of a calibration, each asked as the file asks."""
    results: dict[str, CalibrationResult] = {}
    failures: dict[str, str] = {}
    ways = [fitted_test("auto", test.problem).method for test in config.tests]
    compressible = config.material.compressibility.poisson_ratio is not None
    foams = FOAMS if compressible and set(ways) == {"closed-form"} else ()
    for model, order, label in (*CANDIDATES, *foams):
        material = replace(config.material, model=model, order=order, constants={})
        tests = tuple(
            replace(test, problem=replace(test.problem, material=material)) for test in config.tests
        )
        try:
            names = material.calibrated_names
            bounds = {name: pair for name, pair in config.bounds.items() if name in names}
            design = replace(config, tests=tests, bounds=bounds)
            result = calibrate(design, root, progress=progress, plan=False)
        except InputError as error:
            failures[label] = str(error)
            continue
        if result.converged:
            results[label] = result
        else:
            failures[label] = f"{result.status}: {result.message}"
    eligible = {label: result.fit.aicc for label, result in results.items() if not _unfit(result)}
    return EnergyChoice(results, akaike_weights(eligible), failures)
