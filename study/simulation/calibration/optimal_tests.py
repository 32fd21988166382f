"""The next test of a material that would tell most of the constants that are badly known.

What a test adds to the constants is its information, the squared gradient of its force over the
variance of its rows; it adds to the inverse covariance of the fit. Of tests that could be made
the best is the one that leaves the smallest generalized variance of the badly known constants, the
others being estimated beside them: D_s-optimality (Atkinson, Donev and Tobias 2007, Optimum
Experimental Designs, sec. 10.3). Half the logarithm by which that variance falls is the expected
gain of information, in nats (Lindley 1956, Ann. Math. Stat. 27, 986). Gradients are those of the
closed forms at the fitted constants: exact, and of first order in the constants.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.canonical import Keyed
from study.mechanics.calibration.identifiability import KNOWN, fitted_rows
from study.mechanics.calibration.lack_of_fit import inverse
from study.mechanics.forward.closed_form import height_and_area, indentation
from study.mechanics.material.energy import poisson_from_bulk
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material, is_dimensionless, unit_shown
from study.mechanics.setup.geometry import Sphere
from study.mechanics.setup.test_kind import TEST_KINDS
from study.simulation.calibration.calibration_file import CalibratedTest
from study.simulation.calibration.measured_tests import FitCurve, in_order
from study.simulation.response import in_shown_units

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit


#: kinds of test that are weighed, and the largest strain at which each is looked for
REACH: Mapping[str, float] = {
    "tension": 3.0,
    "compression": 0.6,
    "equibiaxial": 2.0,
    "planar": 3.0,
    "simple-shear": 1.5,
    "indentation": 0.1,
}
#: nominal stress to which a laboratory may go, MPa
STRESS_MPA = 1.0
#: the same over the largest that it went to, where that is more
TIMES_MEASURED = 3.0
#: strain to which tests are compared where the measured ones did not go as far
USUAL_STRAIN = 0.4
#: number of strains tried in the search for the strain that a test must reach
_STRAINS = 80
#: singular value over the largest one below which a test does not see a combination
_SEEN = 1e-6


@dataclass(frozen=True)
class NextTest(Keyed):
    """A test that could be made, and what it would do to the standard errors."""

    KEYS = "kind strain standard_error information_nats combinations needed_strain"

    kind: str
    #: Largest strain (of simple shear the amount of shear, of a sphere depth over radius).
    strain: float
    #: shape (p,); of the constants after it, MPa (exponents plain); infinite where they stay
    #: undetermined.
    standard_error: Array
    #: Expected gain about the badly known constants, nats.
    information_nats: float
    #: Of the constants that this test alone determines.
    combinations: int
    #: Strain from which every constant is known to 10 %; None where no strain does it.
    needed_strain: float | None

    @property
    def words(self) -> str:
        """The test and its strain."""
        size = f"{100 * self.strain:.3g} %"
        if TEST_KINDS[self.kind].takes_indenter:
            return f"indentation by a sphere to {size} of its radius"
        return f"{self.kind.replace('-', ' ')} to {size}"


@dataclass(frozen=True)
class Conditions(Keyed):
    """What a further test has in common with those that were made."""

    KEYS = "noise_N area_mm2 rows stress_MPa effective_rows"

    #: Standard deviation of a row, and the cross-section.
    noise_N: float  # noqa: N815
    area_mm2: float
    rows: int
    #: Share of the rows that their correlation leaves.
    worth: float
    strain: float
    #: Largest nominal stress of a test that can be made, MPa.
    stress_MPa: float  # noqa: N815

    @property
    def effective_rows(self) -> float:
        """What the correlation of the rows leaves of them."""
        return self.worth * self.rows

    @classmethod
    def of(
        cls, fit: Fit, curves: Sequence[FitCurve], tests: Sequence[CalibratedTest], noise: float
    ) -> Conditions:
        """Mean of the recordings; the first specimen."""
        serial = fit.serial
        rows = fit.n if serial is None else serial.rows
        pairs = [(each.curve, tests[each.test].problem.setup) for each in curves]
        # mean strains of the specimens that are not indented
        strains = [
            float(np.abs(curve.displacement_mm).max()) / setup.height_mm
            for curve, setup in pairs
            if setup.height_mm is not None and setup.test.indenter is None
        ]
        stresses = [
            float(np.abs(curve.force_N).max()) / height_and_area(setup.specimen)[1]
            for curve, setup in pairs
        ]
        return cls(
            noise,
            height_and_area(tests[0].problem.setup.specimen)[1],
            max(1, round(rows / len(fit.curves))),
            1.0 if serial is None else serial.effective_rows / serial.rows,
            max([USUAL_STRAIN, *strains]),
            max([STRESS_MPA, *(TIMES_MEASURED * stress for stress in stresses)]),
        )


@dataclass(frozen=True)
class NextTests:
    """Tests that could be made, the best first."""

    names: tuple[str, ...]
    #: shape (p,); as they are known now, MPa (exponents plain).
    values: Array
    standard_error: Array
    #: Those that are badly known, of which the tests shall tell; all where none is.
    sought: tuple[str, ...]
    tests: tuple[NextTest, ...]
    #: What they have in common with those that were made.
    conditions: Conditions

    @property
    def sentence(self) -> str:
        """The best test in words; empty where all constants are known."""
        if np.all(self.standard_error <= KNOWN * np.abs(self.values)):
            return ""
        best = self.tests[0]
        errors_of = zip(
            self.names, self.values, self.standard_error, best.standard_error, strict=True
        )
        says = " and ".join(
            f"of {name} from {_error(name, value, before)} to {_error(name, value, after)}"
            for name, value, before, after in errors_of
            if name in self.sought
        )
        errors = "error" if len(self.sought) == 1 else "errors"
        at = self.conditions
        rows = f"{at.rows:.0f} rows worth {at.effective_rows:.3g}"
        return (
            f"best next test: {best.words} would cut the standard {errors} {says} (as noisy "
            f"as the tests made: {at.noise_N:.2g} N on {at.area_mm2:.3g} mm^2, {rows}, "
            f"up to a nominal stress of {at.stress_MPa:.3g} MPa). "
            + (
                f"No strain of it makes every constant known to {100 * KNOWN:.0f} %"
                if best.needed_strain is None
                else f"It must reach {100 * best.needed_strain:.2g} % for every constant to be "
                f"known to {100 * KNOWN:.0f} %"
            )
        )

    def as_dict(self) -> dict[str, object]:
        """Conditions and tests, the best first; kPa, exponents plain, null where infinite."""
        return {
            "sentence": self.sentence,
            "sought": list(self.sought),
            **self.conditions.keyed(),
            "standard_error": in_shown_units(self.names, self.standard_error),
            "tests": [
                test.keyed() | {"standard_error": in_shown_units(self.names, test.standard_error)}
                for test in self.tests
            ],
        }


def _error(name: str, value: float, error: float) -> str:
    """Say how large the standard error of a constant is. Units: value MPa; error MPa."""
    if not np.isfinite(error):
        return "infinity"
    if value and error < 10 * abs(value):
        return f"{100 * error / abs(value):.2g} %"
    scaled, unit = (error, unit_shown(name)) if is_dimensionless(name) else (1e3 * error, "kPa")
    return f"{scaled:.2g} {unit}".rstrip()


def next_tests(
    fit: Fit, curves: Sequence[FitCurve], material: Material, tests: Sequence[CalibratedTest]
) -> NextTests | None:
    """Rank the tests that could be made next by what they would tell of the constants."""
    if material.relaxation or not fit.curves or not set(fit.names) <= set(material.names):
        return None
    ordered = in_order(curves)
    slopes, weights, left = fitted_rows(fit, ordered)
    freedom = left.size - len(fit.names)
    noise = float(np.sqrt(left @ left / freedom)) if freedom > 0 else 0.0
    if not noise > 0:
        return None
    conditions = Conditions.of(fit, ordered, tests, noise)
    information = _information(fit, weights[:, None] * slopes, weights * left, conditions.worth)
    now = _covariance(information)
    error = np.sqrt(np.diag(now))
    bad = ~(error <= KNOWN * np.abs(fit.values))
    sought = bad if bad.any() else np.ones_like(bad)
    search = _TestSearch(fit.values, material, information, sought, conditions)
    # a test that leaves a badly known constant undetermined comes last
    ranked = sorted(search.tests(), key=lambda pair: pair[0])
    if not ranked:
        return None
    return NextTests(
        fit.names, fit.values, error,
        tuple(n for n, is_sought in zip(fit.names, sought, strict=True) if is_sought),
        tuple(candidate for _, candidate in ranked), conditions,
    )  # fmt: skip


@dataclass(frozen=True)
class _TestSearch:
    """Candidate tests, the constants' values, and the information matrix of the tests made."""

    values: Array
    material: Material
    information: Array
    sought: Flags
    conditions: Conditions

    def tests(self) -> Iterator[tuple[float, NextTest]]:
        """Every test that has an answer, with the log of the variance that it leaves."""
        before = self._left(_covariance(self.information))
        for kind, largest in REACH.items():
            largest = self._reachable(kind, largest)
            strain = min(largest, self.conditions.strain)
            if not strain > 0:
                continue
            (added,) = self._added(kind, np.array([strain]))
            if not np.isfinite(added).all():
                continue
            after = _covariance(self.information + added)
            left = self._left(after)
            gain = 0.5 * (before - left) if np.isfinite(left) else 0.0
            error, needed = np.sqrt(np.diag(after)), self._needed(kind, largest)
            combinations = int(np.count_nonzero(_spectrum(added)[-1]))
            yield left, NextTest(kind, strain, error, gain, combinations, needed)

    def _reachable(self, kind: str, largest: float) -> float:
        """Strain that a test reaches before its stress goes beyond what can be made."""
        rules = TEST_KINDS[kind]
        if rules.takes_indenter:
            return largest
        loading, strains = LOADINGS[rules.mode], largest * np.arange(1, _STRAINS + 1) / _STRAINS
        with np.errstate(all="ignore"):  # NaN says that there is no answer
            stress = loading.nominal(self.material, loading.measure(rules.sense * strains)).stress
        beyond = np.flatnonzero(~(np.abs(stress) <= self.conditions.stress_MPa))
        return largest if not beyond.size else float(np.r_[0.0, strains][beyond[0]])

    def _left(self, covariance: Array) -> float:
        """Log of the generalized variance of the sought constants; infinite where undetermined."""
        part = covariance[np.ix_(self.sought, self.sought)]
        if not np.isfinite(np.diag(part)).all():
            return np.inf
        return float(np.linalg.slogdet(part)[1])

    def _needed(self, kind: str, largest: float) -> float | None:
        """Smallest strain from which every constant is known, to the width of the search."""
        strains = largest * np.geomspace(0.005, 1.0, _STRAINS)
        for strain, added in zip(strains, self._added(kind, strains), strict=True):
            if not np.isfinite(added).all():
                return None
            error = np.sqrt(np.diag(_covariance(self.information + added)))
            if np.all(error <= KNOWN * np.abs(self.values)):
                return float(strain)
        return None

    def _added(self, kind: str, strains: Array) -> Array:
        """Information matrices of tests to some strains, 1 / MPa^2; NaN where there is no answer.

        Shapes: strains (k,); returns (k, p, p).
        """
        at = self.conditions
        rows = np.outer(strains, np.arange(1, at.rows + 1) / at.rows)
        slopes = _slopes(self.material, kind, rows.ravel(), at).reshape(*rows.shape, -1)
        return np.asarray(at.worth / at.noise_N**2 * slopes.transpose(0, 2, 1) @ slopes)


def _slopes(material: Material, kind: str, strain: Array, at: Conditions) -> Array:
    """Differentiate the force by every constant, N / MPa, shape (n, p)."""
    if TEST_KINDS[kind].takes_indenter:
        radius = np.sqrt(at.area_mm2 / np.pi)
        nu = poisson_from_bulk(material.mu0, material.bulk)
        area = indentation(Sphere(radius), radius * strain, height_mm=np.inf, poisson_ratio=nu)
        by = material.mu0_gradient()
        return np.outer(2 * (1 + nu) * area, [by[n] for n in material.names])
    rules = TEST_KINDS[kind]
    loading = LOADINGS[rules.mode]
    with np.errstate(all="ignore"):  # NaN says that there is no answer
        state = loading.nominal(material, loading.measure(rules.sense * strain))
    return np.array([at.area_mm2 * state.gradient[n] for n in material.names]).T


def _information(fit: Fit, jacobian: Array, left: Array, worth: float) -> Array:
    """Inverse covariance of the constants; from the Jacobian where a constant is undetermined."""
    if np.isfinite(fit.covariance).all():
        return inverse(fit.covariance)
    variance = float(left @ left) / (left.size - len(fit.names))
    return np.asarray(worth / variance * jacobian.T @ jacobian)


def _covariance(information: Array) -> Array:
    """Inverse of an information matrix; undetermined directions have infinite variance."""
    outer, values, vectors, seen = _spectrum(information)
    inner = vectors[:, seen] / values[seen] @ vectors[:, seen].T
    lost = np.any(np.abs(vectors[:, ~seen]) > _SEEN, axis=1)
    inner[lost, lost] = np.inf
    return np.asarray(inner / outer)


def _spectrum(information: Array) -> tuple[Array, Array, Array, Flags]:
    """Scales of an information matrix, its spectrum in them, and which combinations it sees."""
    size = np.sqrt(np.diag(information))
    scale = np.where(size > 0, size, 1.0)
    outer = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information / outer)
    return outer, values, vectors, values > _SEEN**2 * values[-1]
