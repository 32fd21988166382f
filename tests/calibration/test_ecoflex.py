"""The constants that the authors of the Ecoflex data published, through our own optimizer."""

import numpy as np
import pytest

from tests.calibration.ecoflex import averaged, fitted, published

#: authors' name -> our energy, its constants, start (MPa)
ENERGIES = {
    "Yeoh_o1": ("reduced-polynomial", ("C10",), [5e-3]),
    "Yeoh_o2": ("reduced-polynomial", ("C10", "C20"), [5e-3, 0]),
    "Yeoh_o3": ("reduced-polynomial", ("C10", "C20", "C30"), [5e-3, 0, 0]),
    "Neo Hookean": ("neo-hookean", ("C10",), [5e-3]),
    "Mooney Rivlin_o1": ("mooney-rivlin", ("C10", "C01"), [5e-3, 0]),
    "Ogden_o1": ("ogden", ("mu1", "alpha1"), [10e-3, 2.0]),
}


@pytest.fixture(scope="module")
def mixes(data_dir):
    folder = data_dir / "ecoflex_compression"
    if not folder.is_dir():
        pytest.skip(f"no Ecoflex measurements in {data_dir}")
    strain, stress = averaged(folder)
    assert len(stress) == 9
    return strain, stress, published(folder)


def _theirs(name, parameters):
    if name == "Neo Hookean":  # theirs is mu = 2 C10
        return np.array(parameters) / 2
    if name == "Ogden_o1":  # theirs is the classical modulus m = 2 mu / alpha
        m, alpha = parameters
        return np.array([m * alpha / 2, alpha])
    return np.array(parameters)


@pytest.mark.parametrize("name", ENERGIES)
def test_published_constants(mixes, name):
    strain, stress, theirs = mixes
    model, names, start = ENERGIES[name]
    for mix in stress:
        found, values, rss = fitted(model, names, strain, stress[mix], start)
        expected = _theirs(name, theirs[mix][name]["parameters"])
        assert found.converged
        # the bar: 1e-4 of the largest constant, 1e-4 of the sum of squares
        assert values == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
        assert rss == pytest.approx(theirs[mix][name]["SSE"], rel=1e-4)


def test_ogden_has_a_second_minimum_that_the_authors_avoided(mixes):
    strain, stress, theirs = mixes
    for mix in stress:
        _, values, rss = fitted("ogden", ("mu1", "alpha1"), strain, stress[mix], [10e-3, -2.0])
        # a negative exponent fits too, but worse: the published optimum is the global one
        assert values[1] < 0
        assert rss > 2 * theirs[mix]["Ogden_o1"]["SSE"]
