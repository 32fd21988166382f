"""Starts that have no answer: what is tried instead, that it is told, counted and resumed."""

from pathlib import Path

import numpy as np
import pytest

from study.ground.curve import Curve
from study.harness.design.load import load
from study.harness.runner.batch import expand
from study.mechanics.calibration.levenberg_marquardt import Status
from study.mechanics.calibration.residual_function import EvaluationFailed, MeasuredCurve
from study.simulation import fit_task
from study.simulation.cell import CellProblem
from study.simulation.fit_task import Checkpoint, StagedSearch, gentler, staged_fit
from study.simulation.fit_task import FitPart as Part

DESIGN = Path(__file__).parents[2] / "designs" / "ecoflex-compression.toml"
NAMES = ("C10", "C20", "C30")
D = np.linspace(0.2, 6.0, 30)
BASIS = np.array([D, 0.1 * D**3, 0.004 * D**5])
TRUTH = np.array([3.2, -0.75, 0.8])
HANDED_ON = np.array([3.17, -0.42, 0.0])
#: a mesh that is coarse already, so that there is one stage, and one that has a cheaper model
COARSE = CellProblem.of({
    "specimen": {"shape": "cylinder", "height_mm": 30.0, "radius_mm": 15.0},
    "test": {"kind": "compression", "displacement_mm": 6.0, "interface": "bonded"},
    "material": {"model": "reduced-polynomial", "order": 3, "poisson_ratio": 0.49},
    "model": {"space": "axisymmetric", "mesh": "coarse"},
})  # fmt: skip
SOLID = COARSE.on_mesh(space="3d")


def response(values):
    """Force, and its slope by a linear one; curved, so that a fit takes several steps."""
    linear = values @ BASIS
    return linear * (1 + 0.02 * linear), 1 + 0.04 * linear


class Softening:
    """A model of three constants; no answer from a cold start where they soften too much.

    Wherever it has once had an answer it finds another one, as a warm start does.
    """

    calls = 0

    def __init__(self, limit):
        self.limit, self.warm = limit, False

    def __call__(self, values):
        Softening.calls += 1
        if not self.warm and values[1] < self.limit and values[2] < 0.1:
            raise EvaluationFailed("no longer elliptic")
        self.warm = True
        force, slope = response(values)
        slopes = slope * BASIS
        return [Curve(D, force, force_gradient=dict(zip(NAMES, slopes, strict=True)))]


def fitted(problem, start, limit=-0.3, **options):
    measured = MeasuredCurve("virtual", Curve(D, response(TRUTH)[0] + 0.01 * np.sin(9 * D)))
    parts = [Part("inverse-fem", problem, (measured,))]
    Softening.calls = 0

    def make(method, own, curves, names):
        if tuple(names) != NAMES:
            raise EvaluationFailed("no forces of a solid of one constant")
        return Softening(limit)

    return staged_fit(parts, start, StagedSearch(NAMES, make=make, **options))


@pytest.mark.parametrize(
    ("limit", "first", "words"),
    [
        (-0.5, [3.17, -0.42, 0.0], []),
        (-0.3, [3.17, -0.21, 0.0], ["the higher constants halved"]),
        (-0.15, [3.17, -0.105, 0.0], ["the higher constants halved twice"] * 2),
        (-0.05, [3.17, 0.0, 0.0], ["the neo-Hookean constant alone"] * 3),
    ],
)
def test_a_start_without_answer_gives_way_to_gentler_ones(limit, first, words):
    found = fitted(COARSE, HANDED_ON, limit)
    assert found.fit.converged
    assert found.fit.values == pytest.approx(TRUTH, rel=1e-2)
    assert found.fit.history[0].x == pytest.approx(first)
    assert found.fruitless == len(words)
    assert found.evaluations == Softening.calls == found.fit.evaluations + len(words)
    assert found.message.endswith(
        f": it was begun with {words[-1]}" if words else found.fit.message
    )


def test_where_nothing_has_an_answer_every_start_is_told():
    found = fitted(COARSE, HANDED_ON, 1.0)
    assert found.fit.status is Status.start_failed
    assert found.evaluations == Softening.calls == 4
    assert "no longer elliptic" in found.message
    assert found.message.endswith("nor from the neo-Hookean constant alone")


def test_the_cheaper_model_falls_back_too_and_every_call_counts():
    found = fitted(SOLID, HANDED_ON)
    assert found.fit.converged
    assert found.rough is not None
    assert found.rough.history[0].x == pytest.approx([3.17, -0.21, 0.0])
    assert found.evaluations == Softening.calls
    assert "the cheaper model led nowhere" in found.message


def test_an_interrupted_fit_goes_on_from_the_start_that_it_had_fallen_back_to(tmp_path):
    through = fitted(COARSE, HANDED_ON)

    def stop(step):
        if step.iteration.iteration == 2:
            raise KeyboardInterrupt

    path = tmp_path / "fit.json"
    with pytest.raises(KeyboardInterrupt):
        fitted(COARSE, HANDED_ON, checkpoint=Checkpoint(path, "key"), progress=stop)
    resumed = fitted(COARSE, HANDED_ON, checkpoint=Checkpoint(path, "key"))
    assert resumed.fit.values.tolist() == through.fit.values.tolist()
    assert resumed.message == through.message
    assert resumed.fruitless == 1


@pytest.mark.parametrize(
    ("names", "start", "bounds", "expected"),
    [
        ("C10 C01", [2.0, 1.0], None, [[2.0, 1.0], [2.5, 0.5], [2.75, 0.25], [3.0, 0.0]]),
        ("C10", [2.0], None, [[2.0]]),
        ("youngs_modulus", [2.0], None, [[2.0]]),
        ("C10 C20", [2.0, 0.0], None, [[2.0, 0.0]]),
        ("mu1 alpha1 mu2 alpha2", [4.0, 6.0, -2.0, -4.0], None,
         [[4.0, 6.0, -2.0, -4.0], [3.0, 4.0, -1.0, -4.0], [2.5, 3.0, -0.5, -4.0],
          [2.0, 2.0, 0.0, -4.0]]),
        ("C10 C20", [3.0, -0.4], [(0.0, 9.0), (-1.0, -0.15)],
         [[3.0, -0.4], [3.0, -0.2], [3.0, -0.15]]),
    ],
)  # fmt: skip
def test_gentler_starts_keep_the_initial_shear_modulus_and_the_bounds(
    names, start, bounds, expected
):
    gentle = gentler(names.split(), np.array(start), bounds)
    assert [one.values.tolist() for one in gentle] == expected


@pytest.mark.slow
def test_the_shipped_study_has_no_fit_that_fails_at_its_start(data_dir):
    """The one of its 288 cases whose start, the fit of one order less, softens too much.

    C20 = -0.42 kPa had no answer beyond 4.2 of 6 mm on the solid's mesh, without C30: the higher
    constants were halved. Since steps are taken again in halves at a limit point it has one.
    """
    if not (data_dir / "ecoflex_compression").is_dir():
        pytest.skip("the Ecoflex measurements are not in the data folder (set STUDY_DATA)")
    work = expand(load(DESIGN), data_dir)
    solid, round_ = (_third_order_fit(work, space) for space in ("3d", "axisymmetric"))
    assert solid.status == "converged", solid.message
    # the equivalent axisymmetric fit of the same curve: C10 to 0.1 %, and the same fit of it
    assert solid.constants["C10"] == pytest.approx(round_.constants["C10"], rel=2e-3)
    assert solid.constants["C20"] == pytest.approx(round_.constants["C20"], rel=0.1)
    assert solid.constants["C30"] == pytest.approx(round_.constants["C30"], rel=0.2)
    assert solid.fit["rss"] == pytest.approx(round_.fit["rss"], rel=0.05)


def _third_order_fit(work, space):
    wanted = {"material": "reduced-polynomial-3", "plates": "bonded", "model.space": space,
              "model.element_order": "quadratic"}  # fmt: skip
    (job,) = (j for j in work.jobs
              if dict(j.case.levels) == wanted and j.case.block == "EF10_25T")  # fmt: skip
    (key,) = (d.fit_key for d in job.directions if d.fit_label == "B")
    assert key is not None
    return _performed(work, key)


def _performed(work, key):
    job = work.fits[key]
    start = None if job.start is None else _performed(work, job.start.key)
    return fit_task.fitted(fit_task.FitJob(job.problem, job.measured, start))
