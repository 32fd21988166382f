"""Finite viscoelasticity of homogeneous tests: closed forms, quadrature, limits, gradients."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from study.ground.errors import InputError
from study.mechanics.material import viscoelasticity
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import RelaxationTerm
from study.mechanics.material.stability import check
from study.mechanics.material.viscoelasticity import relaxing

SERIES = (RelaxationTerm(0.4, 1.0), RelaxationTerm(0.3, 10.0))
RUBBER = Material("neo-hookean", {"C10": 1.0}, incompressible=True, relaxation=SERIES)
FOAMY = Material("gent", {"mu": 1.0, "Jm": 20.0}, poisson_ratio=0.3, relaxation=SERIES)
#: ramp of half a second and a hold: times and their share of the whole deformation
TIME = np.r_[np.linspace(0, 0.5, 4), 0.5 + np.geomspace(0.01, 100, 15)]
RAMP = np.minimum(TIME / 0.5, 1.0)


def left(time, series=SERIES):
    """Relaxation function, written once more."""
    return 1 - sum(t.share * (1 - np.exp(-time / t.time_s)) for t in series)


def test_small_strain_is_a_standard_linear_solid_in_ramp_and_hold():
    """E e' (g t + s T (1 - exp(-t/T))) in the ramp, its fading in the hold (Findley 1976)."""
    share, tau, strain, ramp = 0.4, 2.0, 1e-6, 3.0
    solid = replace(RUBBER, relaxation=(RelaxationTerm(share, tau),))
    time = np.r_[np.linspace(0, ramp, 7), ramp + np.linspace(0.5, 20, 9)]
    stress = relaxing(solid, "uniaxial", time, 1 + strain * np.minimum(time / ramp, 1)).stress
    modulus, rate = 3 * 2.0, strain / ramp
    rising = np.minimum(time, ramp)
    fading = tau * (np.exp(-(time - rising) / tau) - np.exp(-time / tau))
    exact = modulus * rate * ((1 - share) * rising + share * fading)
    # the solid is nonlinear by about the strain
    assert stress == pytest.approx(exact, rel=3e-6)


def uniaxial_by_quadrature(time, rate, end):
    """Convolution of a neo-Hookean solid in a ramp and hold, each direction by quadrature."""
    stretch = lambda s: 1 + rate * min(s, end)  # noqa: E731

    def slope(direction):
        # Pi = 2 C10 (1 - (l^2 + 2 / l) / (3 l_A^2)), differentiated by hand
        def one(s):
            x = stretch(s)
            trace, by_x = x**2 + 2 / x, 2 * x - 2 / x**2
            square, square_by_x = (x**2, 2 * x) if direction == 0 else (1 / x, -1 / x**2)
            return -2 / 3 * rate * (by_x / square - trace * square_by_x / square**2)

        return one

    until = min(time, end)

    def convolved(direction):
        change = slope(direction)
        return float(
            quad(lambda s: left(time - s) * change(s), 0, until, epsabs=1e-14, epsrel=1e-13)[0]
        )

    both = [convolved(0), convolved(1)]
    x = stretch(time)
    return float((x**2 * both[0] - both[1] / x) / x)


@pytest.mark.parametrize("rate", [2.0, -1.0])
def test_a_neo_hookean_ramp_and_hold_is_the_convolution_by_quadrature(rate):
    found = relaxing(RUBBER, "uniaxial", TIME, 1 + 0.5 * rate * RAMP).stress
    exact = np.array([uniaxial_by_quadrature(t, rate, 0.5) for t in TIME])
    assert found[1:] == pytest.approx(exact[1:], rel=1e-8)  # asked for: 1e-6


def test_few_rows_of_a_ramp_give_what_many_do():
    """Rows say where the load is, not how finely the memory is summed up."""
    time = np.linspace(0, 0.5, 101)
    many = relaxing(RUBBER, "equibiaxial", time, 1 + 2 * time).stress[-1]
    few = relaxing(RUBBER, "equibiaxial", time[[0, -1]], 1 + 2 * time[[0, -1]]).stress[-1]
    assert few == pytest.approx(many, rel=1e-7)


@pytest.mark.parametrize("loading", ["uniaxial", "equibiaxial", "planar", "simple-shear"])
@pytest.mark.parametrize("solid", [RUBBER, FOAMY], ids=["incompressible", "compressible"])
def test_a_fast_test_is_elastic(solid, loading):
    time = 1e-9 * TIME
    measure = (0.0 if loading == "simple-shear" else 1.0) + 0.6 * RAMP
    found = relaxing(solid, loading, time, measure)
    elastic = LOADINGS[loading].nominal(solid, measure)
    scale = np.abs(elastic.stress).max()
    assert found.stress == pytest.approx(elastic.stress, abs=1e-6 * scale)
    for name, slope in elastic.gradient.items():
        assert found.gradient[name] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("loading", ["uniaxial", "equibiaxial", "planar", "simple-shear"])
def test_a_slow_test_has_the_long_term_moduli(loading):
    """Where K stays, all moduli of the isochoric energy are 0.3 times as large."""
    for solid in (RUBBER, replace(FOAMY, poisson_ratio=None, bulk_modulus=2.0)):
        measure = (0.0 if loading == "simple-shear" else 1.0) + 0.6 * RAMP
        found = relaxing(solid, loading, 1e8 * TIME, measure).stress
        modulus = next(iter(solid.constants))
        old = {**solid.constants, modulus: 0.3 * solid.constants[modulus]}
        slow = replace(solid, constants=old, relaxation=())
        expected = LOADINGS[loading].nominal(slow, measure).stress
        assert found == pytest.approx(expected, abs=2e-6 * np.abs(expected).max())
        assert solid.long_term_mu == pytest.approx(0.3 * solid.mu0, rel=1e-12)


def by_differential_equations(solid, time, rate, end):
    """Uniaxial stress where the side is free and K finite, by implicit times of an ODE solver.

    The memories obey h' = Pi' - h / T; the free stretch is the root of the side's stress at every
    instant. Nothing is taken from the program but the neo-Hookean formula, written again.
    """
    mu, bulk, series = 2 * solid.constants["C10"], solid.bulk, solid.relaxation
    stays = 1 - sum(t.share for t in series)

    def pi(x, y):
        squares = np.array([x, y, y]) ** 2 * (x * y * y) ** (-2 / 3)
        return mu * (1 - squares.mean() / squares)

    def kirchhoff(x, y, faded):
        J = x * y * y
        squares = np.array([x, y, y]) ** 2 * J ** (-2 / 3)
        inner = squares * ((stays + sum(t.share for t in series)) * pi(x, y) - faded)
        return inner - inner.mean() + bulk * J * (J - 1)

    def side(x, faded):
        return brentq(lambda y: kirchhoff(x, y, faded)[1], 0.3, 2.0, xtol=1e-15)

    # what has faded of each term, f = s (Pi - h), grows as f' = (s Pi - f) / T
    def change(t, state):
        faded = state.reshape(-1, 3)
        x = 1 + rate * min(t, end)
        now = pi(x, side(x, faded.sum(0)))
        return np.concatenate(
            [(one.share * now - f) / one.time_s for one, f in zip(series, faded, strict=True)]
        )

    out = []
    for t in time:
        state = np.zeros(3 * len(series))
        if t > 0:
            for begin, stop in ((0.0, min(t, end)), (end, t)):
                if stop > begin:
                    state = solve_ivp(
                        change, (begin, stop), state, "DOP853", rtol=1e-11, atol=1e-13
                    ).y[:, -1]  # fmt: skip
        x = 1 + rate * min(t, end)
        faded = state.reshape(-1, 3).sum(0)
        y = side(x, faded)
        out.append(kirchhoff(x, y, faded)[0] / x)
    return np.array(out)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_a_free_side_creeps_as_differential_equations_have_it(poisson_ratio):
    solid = replace(RUBBER, incompressible=False, poisson_ratio=poisson_ratio)
    time = np.array([0.0, 0.25, 0.5, 0.8, 2.0, 12.0, 60.0])
    found = relaxing(solid, "uniaxial", time, 1 + 1.2 * np.minimum(time, 0.5)).stress
    exact = by_differential_equations(solid, time, 1.2, 0.5)
    assert found == pytest.approx(exact, abs=3e-7 * exact.max())


CASES = [
    (solid, loading)
    for solid in (RUBBER, FOAMY, replace(FOAMY, poisson_ratio=0.499))
    for loading in ("uniaxial", "equibiaxial", "planar", "simple-shear", "confined", "volumetric")
    if not (solid.incompressible and loading in ("confined", "volumetric"))
]


@pytest.mark.parametrize(("solid", "loading"), CASES, ids=[f"{s.model}-{n}" for s, n in CASES])
def test_gradients_are_those_of_differences(solid, loading, monkeypatch):
    """By every constant, share and time, in a load-unload cycle with a hold."""
    # parts as long as the rows allow: where times change the parts, a difference sees that too
    monkeypatch.setattr(viscoelasticity, "_growing", lambda first: np.ones(1))
    time = np.array([0.0, 0.3, 0.8, 1.5, 2.5, 6.0, 7.0, 20.0])
    share = np.array([0.0, 0.2, 0.5, 0.5, 0.5, 0.1, 0.0, 0.0])
    measure = share if loading == "simple-shear" else 1 + share
    if loading in ("confined", "volumetric"):
        measure = 1 - 0.3 * share
    found = relaxing(solid, loading, time, measure)

    def moved(name, by):
        if name in solid.constants:
            return relaxing(
                solid.with_constants({name: solid.constants[name] + by}), loading, time, measure
            ).stress
        k, key = int(name[-1]) - 1, "share" if name.startswith("share") else "time_s"
        terms = list(solid.relaxation)
        terms[k] = replace(terms[k], **{key: getattr(terms[k], key) + by})
        return relaxing(replace(solid, relaxation=tuple(terms)), loading, time, measure).stress

    assert set(found.gradient) == {*solid.constants, "share1", "time1", "share2", "time2"}
    for name, slope in found.gradient.items():
        step = 1e-5
        difference = (moved(name, step) - moved(name, -step)) / (2 * step)
        assert slope == pytest.approx(difference, rel=1e-6, abs=1e-8), name


def test_a_load_that_comes_at_once_fades_as_the_relaxation_function():
    held = relaxing(RUBBER, "planar", TIME, np.full(TIME.size, 1.7)).stress
    elastic = LOADINGS["planar"].nominal(RUBBER, np.array([1.7])).stress[0]
    assert held == pytest.approx([elastic * left(t) for t in TIME], rel=1e-12)


def test_the_volume_does_not_relax():
    found = relaxing(FOAMY, "volumetric", TIME, 1 - 0.05 * RAMP)
    elastic = LOADINGS["volumetric"].nominal(FOAMY, 1 - 0.05 * RAMP).stress
    assert np.array_equal(found.stress, elastic)
    assert not found.gradient["share1"].any()


@pytest.mark.parametrize(
    ("time", "measure", "words"),
    [
        ([0.0, 1.0, 1.0], [1.0, 1.1, 1.2], "increase"),
        ([0.0, 1.0], [1.0, -0.1], "positive"),
        ([0.0, np.nan], [1.0, 1.1], "finite"),
        ([0.0], [1.0, 1.1], "do not belong"),
    ],
)
def test_a_course_that_cannot_be_is_told(time, measure, words):
    with pytest.raises(InputError, match=words):
        relaxing(RUBBER, "uniaxial", np.array(time), np.array(measure))


def test_shares_that_leave_nothing_are_refused_where_a_user_gives_them():
    with pytest.raises(InputError, match="nothing of the stiffness"):
        check(replace(RUBBER, relaxation=(RelaxationTerm(0.7, 1.0), RelaxationTerm(0.3, 2.0))))
    with pytest.raises(InputError, match="grow by itself"):
        check(replace(RUBBER, relaxation=(RelaxationTerm(-0.1, 1.0),)))
    with pytest.raises(InputError, match="positive and finite"):
        replace(RUBBER, relaxation=(RelaxationTerm(0.1, 0.0),))
    linear = Material("linear-elastic", {"youngs_modulus": 1.0}, poisson_ratio=0.3)
    with pytest.raises(InputError, match="neo-hookean"):
        relaxing(replace(linear, relaxation=SERIES), "uniaxial", TIME, 1 + RAMP)
