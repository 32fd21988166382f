"""``study calibrate --numerics``: data of a far finer mesh, whose constants the bounds hold."""

import numpy as np
import pytest

from study import api
from study.statistics.convergence.grid_convergence import grid_convergence
from tests.cli.small import case_file, gauge, recorded, study

TRUTH = {"C10": 5.0, "C20": 1.0}
SPECIMEN = 'schema = 1\n[specimen]\nshape = "cylinder"\nradius = "10 mm"\nheight = "10 mm"\n'
MATERIAL = '[material]\nmodel = "reduced-polynomial"\norder = 2\npoisson_ratio = 0.49\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Bonded compression by elements of 0.45 mm, a quarter of the coarse ones, in 40 steps."""
    made = tmp_path_factory.mktemp("fine")
    constants = 'C10 = "5 kPa"\nC20 = "1 kPa"\n'
    (made / "truth.toml").write_text(
        f'{SPECIMEN}{MATERIAL}{constants}[model]\nmesh_size = "0.45 mm"\n[test]\n'
        'kind = "compression"\ninterface = "bonded"\ndisplacement = "3 mm"\nsteps = 40\n'
    )
    curve = api.solve(made / "truth.toml", gradients=False).curve
    columns = {
        "displacement": ("mm", np.r_[0, curve.displacement_mm]),
        "force": ("N", np.r_[0, curve.force_N]),
    }
    bonded = 'kind = "compression", interface = "bonded"'
    (made / "tests.toml").write_text(recorded(made, "pressed", bonded, columns, ', points = "raw"'))
    return made


def written(folder, mesh):
    tests = (folder / "tests.toml").read_text()
    return case_file(folder, SPECIMEN, MATERIAL, f'[model]\nmesh = "{mesh}"\n', tests)


def answer(folder, path, *more):
    return study("calibrate", path, "--data", folder, "--results", folder / "r", *more)


@pytest.mark.parametrize(
    "mesh", ["coarse", pytest.param("medium", marks=(pytest.mark.slow, pytest.mark.verify))]
)
def test_the_truth_lies_within_the_bounds(folder, mesh):
    found = api.calibrate(written(folder, mesh), data=folder, numerics=True)
    document, bound = found.to_json(), found.numerics
    assert bound is not None
    # bounds by fits on more meshes stand in place of the estimate, not beside it
    assert document["numerics"] == found.numerical == bound
    half, of_rows = (0.5 * np.diff(fit.ci95)[:, 0] for fit in (found.fit, found.minima[0]))
    u_kPa = np.array([bound["u"][name] for name in found.fit.names])  # noqa: N806
    np.testing.assert_allclose(half, np.hypot(of_rows, 1e-3 * u_kPa), rtol=1e-9)
    for name, truth in TRUTH.items():
        value, u = document["parameters"][name]["value"], bound["u"][name]
        assert abs(value - truth) < u < 0.03 * truth
        assert u == pytest.approx(bound["mesh"][name] + bound["steps"][name], rel=1e-12)
        # the fit's own mesh once more: interpolated between load steps from another start
        own = bound["values"][bound["sizes"].index(1.0)][name]
        assert abs(own - value) <= bound["steps"][name] * (1 + 1e-9)
        # the rules of every response, by hand: without an order thrice the range
        series = [one[name] for one in bound["values"]]
        if grid_convergence(bound["sizes"], series).behaviour == "divergent":
            thrice = 3 * (max(series) - min(series))
            assert bound["mesh"][name] == pytest.approx(thrice, rel=1e-9)


def test_the_terminal_shows_it_beside_the_interval(folder):
    said = answer(folder, written(folder, "coarse"), "--numerics")
    assert said.code == 0, said.err
    assert "95 % interval" in said.out.splitlines()[1]
    assert "numerics" in said.out.splitlines()[1]
    assert said.out.count("+-") == 2
    assert "numerics: from fits on meshes of 1, 0.667, 0.444 times the element size" in said.out


def test_a_closed_form_has_no_numerical_error(tmp_path):
    g = np.arange(1, 11)
    columns = {"strain": ("1", g / 10), "stress": ("kPa", 0.7 * g + 0.01 * (-1) ** g)}
    test = recorded(tmp_path, "shear", 'kind = "simple-shear"', columns)
    head = gauge('model = "neo-hookean"\nincompressible = true')
    path = case_file(tmp_path, head, test)
    found = answer(tmp_path, path, "--numerics", "--json").json["numerics"]
    assert found["u"] == {"C10": 0.0}
    assert found["sentence"] == "no numerical error: every test has a closed form"
    refused = answer(tmp_path, path, "--numerics", "--by", "test")
    assert refused.code == 2
