"""Fields for ParaView: uniform states are known, cells are whole, files can be read."""

from dataclasses import replace
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from study.api import solving
from study.ground.errors import InputError, StoreError
from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import edges_and_facets
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Sphere
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import fields, solve, write_vtu
from tests.fem.problems import NEO_HOOKEAN, compression

ELEMENTS = [(o, s) for o in ("linear", "quadratic") for s in ("simplex", "tensor")]
#: linear bodies know neither stretch nor area
SMALL = Material("linear-elastic", {"youngs_modulus": 3.0}, poisson_ratio=0.3)


def volume(points, cells):
    """Area or volume of cells by their corners; negative where they are turned over."""
    n = {"tri": 3, "qua": 4, "tet": 4, "hex": 8}[cells.type[:3]]
    corner = points[cells.data[:, :n]]
    if cells.type.startswith("hex"):
        a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 3, 4))
        return float(np.einsum("ij,ij->i", np.cross(a, b), c).sum())
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2 if n != 4 else -1] - corner[:, 0]
    if cells.type.startswith("tet"):
        a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
        return float(np.einsum("ij,ij->i", np.cross(a, b), c).sum() / 6)
    return float(np.cross(a, b)[:, 2].sum() * (0.5 if n == 3 else 1.0))


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize(("order", "shape"), ELEMENTS)
@pytest.mark.parametrize("formulation", ["mixed", "displacement"])
def test_uniform_compression(space, order, shape, formulation, tmp_path):
    """Frictionless compression: the axial stress is F / (deformed area), the others vanish."""
    specimen = Cylinder(1.0, 1.0) if space == "axisymmetric" else Block(1.0, 1.0, 1.0)
    problem = compression(
        specimen, 0.2, "frictionless", space=space, element_order=order, element_shape=shape,
        formulation=formulation, mesh_size_mm=0.3,
    )  # fmt: skip
    solution = solve(problem)
    write_vtu(solution, tmp_path / "out.vtu")
    read = meshio.read(tmp_path / "out.vtu")
    stress = read.cell_data["cauchy_stress_MPa"][0].reshape(-1, 3, 3)
    J = read.cell_data["J"][0]
    area = np.pi if space == "axisymmetric" else 1.0
    expected = np.zeros((3, 3))
    axis = 1 if space == "axisymmetric" else 2
    expected[axis, axis] = -solution.curve.force_N[-1] / (area * J.mean() / 0.8)
    # sums of many entries, solved to 1e-8 of the force
    np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), atol=2e-6)
    np.testing.assert_allclose(read.cell_data["mean_stress_MPa"][0], np.trace(expected) / 3, 1e-5)
    np.testing.assert_allclose(read.cell_data["von_mises_MPa"][0], -expected[axis, axis], 1e-5)
    np.testing.assert_allclose(J, 1 + np.trace(expected) / 3 / NEO_HOOKEAN.bulk, atol=1e-8)
    top = read.points[:, axis] == read.points[:, axis].max()
    # the half above the middle plane
    np.testing.assert_allclose(read.point_data["displacement_mm"][top, axis], -0.1, atol=1e-12)
    found = fields(solution)
    for data in (found.cellular, found.nodal):
        strain = data["log_strain"].reshape(-1, 3, 3)
        np.testing.assert_allclose(strain[:, axis, axis], np.log(0.8), rtol=1e-6)
        np.testing.assert_allclose(data["principal_stretch"][:, 2], 0.8, rtol=1e-6)
        np.testing.assert_allclose(strain[:, 0, 0], -np.log(0.8) / 2, rtol=1e-2)
    below = found.points[:, axis] < 1 - 1e-9
    np.testing.assert_allclose(found.nodal["contact_pressure_MPa"][below], 0.0)


def test_small_strain_stress():
    """Uniaxial strain energy aside: sigma = E eps, J = 1 + (1 - 2 nu) eps."""
    problem = compression(Cylinder(1.0, 1.0), 1e-3, "frictionless", material=SMALL)
    solution = solve(problem, gradients=False)
    found = fields(solution)
    stress = found.cellular["cauchy_stress_MPa"]
    np.testing.assert_allclose(stress[:, 4], -3e-3, rtol=1e-7)
    np.testing.assert_allclose(stress[:, 0], 0, atol=1e-10)
    np.testing.assert_allclose(found.cellular["J"], 1 - 0.4e-3, rtol=1e-9)
    assert solution.equilibria.contact[-1].area_mm2 == pytest.approx(np.pi, rel=1e-6)


def test_without_an_answer_there_are_no_fields(tmp_path):
    soft = Material("reduced-polynomial", {"C10": 1.0, "C20": -5.0}, bulk_modulus=1000.0)
    unstable = solve(compression(Cylinder(1.0, 1.0), 0.6, material=soft))
    with pytest.raises(InputError, match="no step converged"):
        write_vtu(unstable, tmp_path / "out.vtu")


def test_a_folder_that_does_not_exist(tmp_path):
    solution = solve(compression(Cylinder(1.0, 1.0), 0.05, mesh_size_mm=0.5), gradients=False)
    with pytest.raises(StoreError, match=r"out\.vtu: could not be written \(No such file"):
        solving.write_vtu(solution, tmp_path / "nowhere" / "out.vtu")


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize(("order", "shape"), ELEMENTS)
def test_cells_fill_the_specimen_and_its_whole(space, order, shape):
    specimen = Cylinder(1.0, 1.0) if space == "axisymmetric" else Block(1.0, 1.2, 1.0)
    problem = compression(
        specimen, 0.1, space=space, element_order=order, element_shape=shape, mesh_size_mm=0.4
    )
    solution = solve(problem, gradients=False)
    part = fields(solution)
    whole = part.whole()
    assert whole.whole() is whole
    level = whole.points[:, 1 if space == "axisymmetric" else 2]
    axial = whole.displacement[:, 1 if space == "axisymmetric" else 2]
    assert axial[level == 0] == pytest.approx(0, abs=1e-12)  # the base rests
    assert axial[level == 1] == pytest.approx(-0.1)
    cells = [meshio.CellBlock(f.kind, f.cells) for f in (part, whole)]
    parts, size = (4, 0.5) if space == "axisymmetric" else (8, 1.2 / 8)
    sizes = [volume(f.points, c) for f, c in zip((part, whole), cells, strict=True)]
    assert sizes == pytest.approx([size, parts * size], rel=1e-9)
    assert sorted(np.unique(part.cells)) == list(range(len(part.points)))
    if order == "quadratic":  # the last point of a cell is in the middle of others
        ends = {"triangle6": [0, 2], "tetra10": [2, 3], "quad9": [0, 1, 2, 3]}
        between = part.points[part.cells[:, ends.get(part.kind, list(range(8)))]].mean(axis=1)
        np.testing.assert_allclose(part.points[part.cells[:, -1]], between, atol=1e-12)
    if shape == "simplex":  # by corners only these have their volume once they are deformed
        moved = [volume(f.points + f.displacement, c)
                 for f, c in zip((part, whole), cells, strict=True)]  # fmt: skip
        assert moved[1] == pytest.approx(parts * moved[0])
    # points of the planes stand once; the forces on all nodes balance, and those of the upper face
    # are the plate's
    assert len(np.unique(np.round(whole.points, 9), axis=0)) == len(whole.points)
    forces, axis = whole.nodal["reaction_N"], 1 if space == "axisymmetric" else 2
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 * solution.curve.force_N[-1]
    upper = whole.points[:, axis] > 0.75
    assert -forces[upper, axis].sum() == pytest.approx(solution.curve.force_N[-1], rel=2e-6)


def pressed_N(path, axis):  # noqa: N802
    """Axial component of the pressure of a file over its deformed surface, of the whole body."""
    read = meshio.read(path)
    (block,) = read.cells
    parts = edges_and_facets(block.type.rstrip("0123456789"))[1]
    every = np.vstack([block.data[:, list(part)] for part in parts])
    _, first, count = np.unique(
        np.sort(every, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = every[first[count == 1]]
    places = (read.points + read.point_data["displacement_mm"])[outer]
    pressure = read.point_data["contact_pressure_MPa"][outer]
    if axis == 1:  # linear along an edge, around the axis
        (a, b), (r, s) = pressure.T, places[:, :, 0].T
        return float(2 * np.pi * np.abs((s - r) * (a * (2 * r + s) + b * (r + 2 * s)) / 6).sum())
    area = np.cross(places, np.roll(places, -1, axis=1)).sum(axis=1)[:, 2] / 2
    return float(4 * np.abs(area * pressure.mean(axis=1)).sum())  # four quarters


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize(("order", "shape"), ELEMENTS)
def test_the_integral_of_the_pressure_is_the_force(space, order, shape, tmp_path):
    """On a plane face exactly; on a curved one as well as facets follow it."""
    specimen = Cylinder(1.0, 1.0) if space == "axisymmetric" else Block(2.0, 2.0, 1.0)
    plates = compression(
        specimen, 0.2, "frictionless", space=space, element_order=order, element_shape=shape,
        mesh_size_mm=0.4,
    )  # fmt: skip
    ball = Test("indentation", 0.2, "frictionless", "bonded", 2, Sphere(2.0))
    for problem, apart in ((plates, 1e-6), (replace(plates, test=ball), 0.01)):
        solution = solve(problem, gradients=False)
        write_vtu(solution, tmp_path / "out.vtu")
        force = pressed_N(tmp_path / "out.vtu", 1 if space == "axisymmetric" else 2)
        assert force == pytest.approx(solution.curve.force_N[-1], rel=apart)


@pytest.mark.parametrize("indenter", [None, Cone(60.0)])
def test_pressure_of_nodes_is_no_shear(indenter):
    """The largest of the fields is the peak pressure; a held face and an axis bear shear, too."""
    problem = compression(Cylinder(1.0, 1.0), 0.2, mesh_size_mm=0.2)
    if indenter is not None:
        test = Test("indentation", 0.1, "frictionless", "bonded", 4, indenter)
        problem = replace(problem, test=test)
    solution = solve(problem, gradients=False)
    pressure = fields(solution).nodal["contact_pressure_MPa"]
    peak = solution.equilibria.contact[-1].peak_pressure_MPa
    assert float(pressure.max()) == pytest.approx(peak, rel=1e-9)


def test_a_series_has_every_step_and_what_holds_the_body(tmp_path):
    problem = compression(Cylinder(1.0, 1.0), 0.2, steps=3, mesh_size_mm=0.4)
    solution = solve(problem, gradients=False)
    solving.write_vtu(solution, tmp_path / "run.pvd")
    root = ElementTree.parse(tmp_path / "run.pvd").getroot()
    rows = [(float(row.attrib["timestep"]), row.attrib["file"]) for row in root.iter("DataSet")]
    np.testing.assert_allclose([d for d, _ in rows], solution.curve.displacement_mm)
    for k, (_, name) in enumerate(rows):
        read = meshio.read(tmp_path / name)
        assert {"contact_pressure_MPa", "contact_gap_mm", "log_strain"} <= set(read.point_data)
        grid = ElementTree.parse(tmp_path / name).getroot()
        facts = {one.attrib["Name"]: one.text or "" for one in grid.iter("FieldData").__next__()}
        assert float(facts["plate_axial_N"]) == pytest.approx(solution.curve.force_N[k], rel=1e-6)
        assert float(facts["modelled_share"]) == 0.5
        assert (
            "a section from the axis of the body, its upper half" in (tmp_path / name).read_text()
        )
