"""``study export --as abaqus`` and ``--as febio``: stress recomputed from the exported text.

The formulas are those of the manuals (Abaqus Theory Guide, Hyperelastic material behavior; FEBio
User Manual, Uncoupled materials), written here once more and differentiated by nothing but a
complex step, so that no code of ours is between the file and the stress.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from study.ground.arrays import Array
from study.mechanics.material.homogeneous import first_piola
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import RelaxationTerm
from tests.cli.small import refusal, success

#: name, keys of [material] in MPa, and the same constants
ENERGIES = {
    "neo-hookean": {"C10": 0.02},
    "mooney-rivlin": {"C10": 0.02, "C01": 0.005},
    "reduced-polynomial": {"C10": 0.02, "C20": 0.003, "C30": 0.0004},
    "polynomial": {"C10": 0.02, "C01": 0.004, "C20": 0.003, "C11": 0.001, "C02": 0.0005},
    "yeoh": {"C10": 0.02, "C20": 0.003, "C30": 0.0004},
    "ogden": {"mu1": 0.03, "alpha1": 2.5, "mu2": 0.01, "alpha2": -3.0},
    "arruda-boyce": {"mu": 0.03, "lambda_m": 2.8},
    "gent": {"mu": 0.03, "Jm": 30.0},
    "van-der-waals": {"mu": 0.03, "lambda_m": 8.0, "a": 0.3, "beta": 0.2},
    "veronda-westmann": {"C1": 0.03, "C2": 0.8},
    "fung": {"mu": 0.03, "b": 0.5},
    "extended-tube": {"Gc": 0.02, "Ge": 0.01, "beta": 0.3, "delta": 0.09},
}
PLAIN = {"alpha1", "alpha2", "lambda_m", "Jm", "a", "beta", "C2", "b", "delta"}
BULK = 0.4
#: whom they have
ABAQUS = {
    "neo-hookean", "mooney-rivlin", "reduced-polynomial", "polynomial", "yeoh", "ogden",
    "arruda-boyce", "van-der-waals",
}  # fmt: skip
FEBIO = {
    "neo-hookean", "mooney-rivlin", "reduced-polynomial", "yeoh", "ogden", "arruda-boyce", "gent",
    "veronda-westmann",
}  # fmt: skip
SERIES = 1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750

Energy = Callable[[Array], complex]


def problem(folder, energy, volume=f'bulk_modulus = "{BULK} MPa"'):
    constants = ENERGIES[energy]
    if energy == "ogden":
        lines = ['mu = ["0.03 MPa", "0.01 MPa"]', "alpha = [2.5, -3.0]"]
    else:
        plain = PLAIN if energy in ("gent", "fung", "veronda-westmann") else PLAIN - {"C2"}
        lines = [f"{n} = {v}" if n in plain else f'{n} = "{v} MPa"' for n, v in constants.items()]
    path = folder / f"{energy}.toml"
    path.write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\n[test]\nkind = "tension"\n'
        f'displacement = "0.1 mm"\n[material]\nmodel = "{energy}"\n{volume}\n' + "\n".join(lines)
    )
    return path


def exported(folder, energy, program, *more):
    asked = ["--as", program, "--reports", str(folder), *more]
    answer = success("export", str(problem(folder, energy)), *asked, "--json")
    text = Path(next(iter(answer.json["files"].values()))).read_text()
    assert text == answer.json["text"]
    return text


def states():
    """Twenty stretches and rotations, shape (3, 3, 20)."""
    rng = np.random.default_rng(3)
    out = []
    for _ in range(20):
        rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        out.append(rotation @ np.diag(np.exp(rng.uniform(-0.3, 0.35, 3))) @ turned.T)
    F = np.array(out)
    return np.moveaxis(F * np.sign(np.linalg.det(F))[:, None, None], 0, -1)


def invariants(C):
    """I1 and I2 of C without its volume change, and J; C may be complex."""
    J = np.linalg.det(C) ** 0.5
    first = np.trace(C)
    second = 0.5 * (first**2 - np.trace(C @ C))
    return first * J ** (-2 / 3), second * J ** (-4 / 3), J


def stress(energy, F):
    """First Piola-Kirchhoff stress by a complex step, or by differences of principal stretches."""
    out, h = np.empty((3, 3)), 1e-30
    for i in range(3):
        for j in range(3):
            moved = F.astype(complex)
            moved[i, j] += 1j * h
            out[i, j] = complex(energy(moved.T @ moved)).imag / h
    return out


def ogden_stress(terms, pressure, F):
    """P of W = sum c/m^2 (sum bar^m - 3) + U, by principal stretches."""
    left, stretch, right = np.linalg.svd(F)
    J = float(np.prod(stretch))
    bar = stretch / J ** (1 / 3)
    tau = sum(c / m * (bar**m - (bar**m).mean()) for c, m in terms) + J * pressure(J)
    return np.asarray(left @ np.diag(tau / stretch) @ right)


def abaqus_stress(text, F):
    """Stress of an exported text by the formulas of Abaqus' Theory Guide."""
    lines = [line for line in text.splitlines() if not line.startswith("**")]
    head = next(line for line in lines if line.startswith("*Hyperelastic"))
    data = lines[lines.index(head) + 1 :]
    rows = [line for line in data if re.match(r"[-\d]", line)]
    v = [float(one) for line in rows for one in line.split(",")]
    order = int(found[1]) if (found := re.search(r"n=(\d+)", head)) else 1
    if "ogden" in head:
        terms = [(2 * v[2 * k], v[2 * k + 1]) for k in range(order)]
        assert len(v) == 3 * order
        assert not any(v[2 * order + 1 :])
        return ogden_stress(terms, lambda J: 2 / v[2 * order] * (J - 1), F)

    def energy(C):
        a, b, J = invariants(C)
        squared = (J - 1) ** 2
        if "arruda" in head:
            mu, limit, D = v
            chain = sum(
                c / limit ** (2 * k) * (a ** (k + 1) - 3 ** (k + 1)) for k, c in enumerate(SERIES)
            )
            return mu * chain + ((J * J - 1) / 2 - np.log(J)) / D
        if "waals" in head:
            mu, limit, attraction, beta, D = v
            mixed = (1 - beta) * a + beta * b
            eta = ((mixed - 3) / (limit**2 - 3)) ** 0.5
            chain = -(limit**2 - 3) * (np.log(1 - eta) + eta)
            pulled = 2 / 3 * attraction * ((mixed - 3) / 2) ** 1.5
            return mu * (chain - pulled) + ((J * J - 1) / 2 - np.log(J)) / D
        x, y = a - 3, b - 3
        if "neo" in head:
            return v[0] * x + squared / v[1]
        if "mooney" in head:
            return v[0] * x + v[1] * y + squared / v[2]
        if "yeoh" in head or "reduced" in head:
            count = 3 if "yeoh" in head else order
            assert len(v) == 2 * count
            return sum(v[k] * x ** (k + 1) for k in range(count)) + squared / v[count]
        assert "polynomial" in head
        assert order == 2
        assert len(v) == 7
        c10, c01, c20, c11, c02, D, _ = v
        return c10 * x + c01 * y + c20 * x * x + c11 * x * y + c02 * y * y + squared / D

    return stress(energy, F)


def febio_stress(text, F):
    """Stress of an exported text by the formulas of FEBio's manual."""
    (material,) = ET.fromstring(text).findall("Material/material")
    assert material.findtext("pressure_model") == "Abaqus"  # U = k/2 (J - 1)^2
    v = {e.tag: float(e.text or "") for e in material if e.tag != "pressure_model"}
    kind = material.get("type")
    if kind == "Ogden":
        terms = [(v[f"c{k}"], v[f"m{k}"]) for k in (1, 2)]
        return ogden_stress(terms, lambda J: v["k"] * (J - 1), F)

    def energy(C):
        a, b, J = invariants(C)
        volume = 0.5 * v["k"] * (J - 1) ** 2
        if kind == "Mooney-Rivlin":
            return v["c1"] * (a - 3) + v["c2"] * (b - 3) + volume
        if kind == "Yeoh":
            return sum(v[f"c{k}"] * (a - 3) ** k for k in range(1, 7) if f"c{k}" in v) + volume
        if kind == "Arruda-Boyce":
            chain = sum(
                c / v["N"] ** k * (a ** (k + 1) - 3 ** (k + 1)) for k, c in enumerate(SERIES)
            )
            return v["mu"] * chain + volume
        if kind == "Gent":
            return -0.5 * v["G"] * v["Jm"] * np.log(1 - (a - 3) / v["Jm"]) + volume
        assert kind == "Veronda-Westmann"
        grown = v["c1"] * (np.exp(v["c2"] * (a - 3)) - 1)
        return grown - 0.5 * v["c1"] * v["c2"] * (b - 3) + volume

    return stress(energy, F)


@pytest.mark.parametrize(
    ("program", "stress_of", "energy"),
    [("abaqus", abaqus_stress, energy) for energy in sorted(ABAQUS)]
    + [("febio", febio_stress, energy) for energy in sorted(FEBIO)],
)
def test_the_program_has_the_same_stress(tmp_path, program, stress_of, energy):
    text, F = exported(tmp_path, energy, program), states()
    if program == "abaqus" and energy in ("arruda-boyce", "van-der-waals"):
        # another volumetric term, and the file says so
        assert "((J^2 - 1)/2 - ln J)/D" in text
        F = F / np.cbrt(np.linalg.det(np.moveaxis(F, -1, 0)))
    ours = first_piola(Material(energy, ENERGIES[energy], bulk_modulus=BULK), F)
    theirs = np.stack([stress_of(text, F[..., k]) for k in range(20)], axis=-1)
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("energy", "program"),
    [(e, "abaqus") for e in sorted(set(ENERGIES) - ABAQUS)]
    + [(e, "febio") for e in sorted(set(ENERGIES) - FEBIO)],
)
def test_a_program_without_the_energy_is_told(tmp_path, energy, program):
    path = problem(tmp_path, energy)
    answer = refusal("export", str(path), "--as", program, "--reports", str(tmp_path / "out"))
    assert f"{program} has no energy with" in answer.err
    assert not (tmp_path / "out").exists()


def test_relaxation_is_exported_with_instantaneous_constants(tmp_path):
    fading = 'material.relaxation=[{share=0.3,time="2 s"},{share=0.2,time="1 min"}]'
    more = ("-s", fading, "-s", 'test.speed="1 mm/s"')
    text = exported(tmp_path, "neo-hookean", "abaqus", *more)
    assert "*Hyperelastic, neo hooke, moduli=instantaneous\n0.02, 5.0\n" in text
    assert text.endswith("*Viscoelastic, time=prony\n0.3, 0., 2.0\n0.2, 0., 60.0\n")
    text = exported(tmp_path, "neo-hookean", "febio", *more)
    (material,) = ET.fromstring(text).findall("Material/material")
    assert material.get("type") == "uncoupled viscoelastic"
    assert float(material.findtext("k") or "") == BULK
    given = {n: float(material.findtext(n) or "nan") for n in ("g0", "g1", "t1", "g2", "t2")}
    assert given == pytest.approx({"g0": 0.5, "g1": 0.3, "t1": 2.0, "g2": 0.2, "t2": 60.0})
    elastic = material.find("elastic")
    assert elastic is not None
    assert elastic.get("type") == "Mooney-Rivlin"
    assert elastic.find("k") is None  # it belongs to the outer material
    # FEBio's own sum g0 + sum g exp(-t / T) of these is our relaxation function
    series = (RelaxationTerm(0.3, 2.0), RelaxationTerm(0.2, 60.0))
    for t in (0.0, 1.0, 30.0):
        ours = 1 - sum(one.share * (1 - np.exp(-t / one.time_s)) for one in series)
        theirs = given["g0"] + sum(given[f"g{k}"] * np.exp(-t / given[f"t{k}"]) for k in (1, 2))
        assert ours == pytest.approx(theirs, rel=1e-12)


def test_what_a_material_needs_and_what_drucker_says_of_it_is_told(tmp_path):
    path = problem(tmp_path, "ogden", "incompressible = true")
    answer = success(f"export {path} --as abaqus --reports {tmp_path}")
    assert "hybrid elements" in answer.out
    assert "0.03, 2.5, 0.01, -3.0, 0.0, 0.0" in (tmp_path / "ogden.inp").read_text()
    success(f"export {path} --as febio --reports {tmp_path}")
    (material,) = ET.fromstring((tmp_path / "ogden.feb").read_text()).findall("Material/material")
    assert float(material.findtext("k") or "") == pytest.approx(40.0)
    assert "stable in uniaxial, equibiaxial and planar" in exported(tmp_path, "yeoh", "abaqus")
    soft = "-s 'material.C20=-3 kPa' -s 'material.C30=0 kPa'"
    answer = success(f"export {tmp_path}/yeoh.toml --as abaqus {soft} --reports {tmp_path}")
    assert "unstable (Drucker)" in answer.err
    assert "unstable (Drucker)" in (tmp_path / "yeoh.inp").read_text()
    constants = "\n".join(f'C{k}0 = "1 kPa"' for k in range(1, 8))
    text = problem(tmp_path, "reduced-polynomial").read_text()
    path.write_text(text[: text.index("C10")] + constants)
    assert "6 terms" in refusal(f"export {path} --as abaqus --reports {tmp_path}/out").err
