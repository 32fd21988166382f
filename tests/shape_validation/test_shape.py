"""``study shape`` end to end: scans of bodies whose deformed shape is known in closed form."""

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

import study
from study.ground.errors import InputError, RefusedError
from study.laboratory.registration.iterative_closest_point import TriangleSurface
from study.laboratory.registration.rigid import turned_about
from study.laboratory.shape.boundary import DeformedMesh, surface_of, symmetry_of
from study.laboratory.shape.shape_deviation import ShapeOptions as Options
from study.mechanics.mesh.structured import extrude, rectangle
from study.reporting.output.laboratory_pages import scan_answers
from tests.cli.small import case_file, pressed, success
from tests.fem.problems import LONG, long_verification
from tests.fem.surfaces import write
from tests.registration.bodies import egg, scan

#: Lubricated compression of an incompressible cylinder: stretch 0.8 along, 0.8^-1/2 across.
PROBLEM = pressed(
    '[material]\nmodel = "neo-hookean"\nC10 = "5 kPa"\nincompressible = true\n'
    '[model]\nspace = "axisymmetric"\nmesh_size = "5 mm"\n',
    radius=20,
    height=30,
    test='displacement = "6 mm"\nsteps = 2\n',
)
HEIGHT = 24.0
RADIUS = 20.0 / np.sqrt(0.8)
MOTION = turned_about(np.zeros(3), np.array([0.3, -0.2, 0.5]), np.array([40.0, -10, 25]))
AS_IT_LIES = Options(register=False)


def problem(folder):
    return case_file(folder, PROBLEM)


def cylinder(radius, height, n, seed, noise=0.0):
    """Points spread evenly over a cylinder about z whose middle is the origin, mm."""
    rng = np.random.default_rng(seed)
    side = 2 * np.pi * radius * height
    ends = 2 * np.pi * radius**2
    turn = 2 * np.pi * rng.random(n)
    lies = rng.random(n) < side / (side + ends)
    r = np.where(lies, radius, radius * np.sqrt(rng.random(n)))
    z = np.where(lies, height * (rng.random(n) - 0.5), height / 2 * rng.choice([-1, 1], n))
    points = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
    return np.asarray(points + noise * rng.standard_normal((n, 3)))


def write_csv(path, points, header="x,y,z"):
    path.write_text("\n".join([header, *(",".join(f"{v:.9g}" for v in row) for row in points)]))
    return path


def write_ply(path, surface):
    return Path(write(path, (surface.points, surface.triangles)))


def test_the_scan_of_the_closed_form_is_on_the_surface(tmp_path):
    cloud = write(tmp_path / "scan.ply", (MOTION(cylinder(RADIUS, HEIGHT, 1000, 1)), []))
    command = ("shape", problem(tmp_path), "--scan", cloud, "--reports", tmp_path / "reports")
    found = success(*command, "--json").json
    # chords of 180 segments lie up to 1.5e-4 radii inside the circle: 0.0034 mm
    assert found["deviation_mm"]["largest"] < 0.006
    assert found["registration"]["null_space"] == ["rotation about (0.00, 0.00, 1.00)"]
    assert found["seen"] > 0.95
    assert "revolved" in found["symmetry"]
    page = Path(found["report"]).read_text()
    assert "Figure missing" not in page
    assert not [word for word in ("https:", "src=") if word in page]
    assert page.count("<script") == 1  # the one that sorts tables
    few = write(tmp_path / "few.ply", (MOTION(cylinder(RADIUS, HEIGHT, 300, 1)), []))
    assert "rotation about" in success("shape", problem(tmp_path), "--scan", few).out


@long_verification
def test_a_body_that_is_larger_deviates_by_as_much(tmp_path):
    """0.3 mm more radius, the same height: every point of the side is 0.3 mm off."""
    cloud = MOTION(cylinder(RADIUS + 0.3, HEIGHT, 4000, 2))
    found = study.shape(problem(tmp_path), write_csv(tmp_path / "scan.csv", cloud))
    side = np.abs(found.normals[:, 2]) < 0.5
    assert found.distances[side].mean() == pytest.approx(0.3, abs=0.01)
    assert np.abs(found.distances[~side].mean()) < 0.01
    assert found.statistics.mean == pytest.approx(0.3 * side.mean(), abs=0.01)


def test_noise_and_outliers_are_counted_and_do_no_harm(tmp_path):
    rng = np.random.default_rng(3)
    points = cylinder(RADIUS, HEIGHT, 4000, 3, noise=0.05)
    strewn = rng.uniform(-200, 200, (200, 3))
    cloud = write_csv(tmp_path / "scan.csv", MOTION(np.vstack([points, strewn])))
    found = study.shape(problem(tmp_path), cloud)
    assert found.outliers == pytest.approx(200, abs=10)
    # noise in every direction leaves its normal component
    assert found.registration.scale_mm == pytest.approx(0.05, rel=0.1)
    assert 0 < found.registration_uncertainty < 0.01


@pytest.mark.parametrize("space", ["axisymmetric", pytest.param("3d", marks=LONG)])
def test_markers_inside_move_as_the_closed_form_says(tmp_path, space):
    rng = np.random.default_rng(4)
    turn, r = 2 * np.pi * rng.random(20), 18 * np.sqrt(rng.random(20))
    rest = np.column_stack([r * np.cos(turn), r * np.sin(turn), rng.uniform(-14, 14, 20)])
    stretch = np.array([0.8**-0.5, 0.8**-0.5, 0.8])
    put_in = np.tile([0.0, 0.0, -3.0], (20, 1))  # the base rests, so that the middle goes down
    put_in[:5, 2] += 0.5
    both = np.column_stack([MOTION(rest), MOTION(rest * stretch + put_in)])
    markers = write_csv(tmp_path / "beads.csv", both, "x0,y0,z0,x,y,z")
    scanned = cylinder(RADIUS, HEIGHT, 1000, 4) + [0, 0, -3.0]
    cloud = write_csv(tmp_path / "scan.csv", MOTION(scanned))
    found = study.shape(
        problem(tmp_path), cloud, markers=markers, overrides=[f"model.space={space}"]
    ).markers
    assert found.paired
    assert found.outside == 0
    # a homogeneous field is linear, so nothing is lost between the nodes; registration 0.005 mm
    assert found.sizes[:5] == pytest.approx(0.5, abs=0.02)
    assert found.sizes[5:].max() < 0.02


def test_a_vtu_file_says_the_same_as_its_problem(tmp_path):
    file, vtu = problem(tmp_path), tmp_path / "solution.vtu"
    success("solve", file, "--vtu", vtu, "--json")
    cloud = write_csv(tmp_path / "scan.csv", cylinder(RADIUS, HEIGHT, 400, 5, noise=0.05))
    numbers = [study.shape(source, cloud).statistics.rms for source in (file, vtu)]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-9)


def test_a_vtu_file_that_unpacks_to_gigabytes_is_refused(tmp_path):
    part = zlib.compress(bytes(300_000_000), 1)
    header = np.array([1, 300_000_000, 0, len(part)], dtype="<u4").tobytes()
    head = (
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
        'compressor="vtkZLibDataCompressor"><UnstructuredGrid><Piece NumberOfPoints="9" '
        'NumberOfCells="1"><Points><DataArray type="Float64" Name="Points" NumberOfComponents="3" '
    )
    tail = "</Points></Piece></UnstructuredGrid>"
    packed = (base64.b64encode(header) + base64.b64encode(part)).decode()
    inline = f'{head}format="binary">{packed}</DataArray>{tail}</VTKFile>'.encode()
    text = f'{head}format="appended" offset="0"/>{tail}<AppendedData encoding="raw">_'.encode()
    appended = text + header + part + b"\n</AppendedData></VTKFile>"
    cloud = write_csv(tmp_path / "scan.csv", cylinder(RADIUS, HEIGHT, 100, 5))
    for content in (inline, appended):
        (tmp_path / "large.vtu").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read: large.vtu: unpacked, "):
            study.shape(tmp_path / "large.vtu", cloud)


def moved_egg(folder):
    surface = egg()
    cloud = MOTION(scan(surface, 2000, np.random.default_rng(6)))
    return write_ply(folder / "egg.ply", surface), write_csv(folder / "scan.csv", cloud)


def test_a_surface_file_is_compared_too_and_marks_lie_on_it(tmp_path):
    surface, cloud = moved_egg(tmp_path)
    marks = egg().points[:6] + 0.4 * egg().vertex_normals[:6]
    markers = write_csv(tmp_path / "marks.csv", MOTION(marks))
    found = study.shape(surface, cloud, markers=markers)
    assert found.statistics.largest < 1e-5
    assert not found.markers.paired
    assert found.markers.sizes == pytest.approx(0.4, rel=0.05)


def test_the_known_pair_of_brain_surfaces(data_dir):
    """The collector of the data measured 0.309 mm on average and 2.461 mm at worst."""
    folder = data_dir / "brain_surface"
    if not folder.is_dir():
        pytest.skip(f"no brain surfaces in {data_dir}")
    fine, coarse = (folder / f"mni152_outer_{name}.stl" for name in ("fine", "coarse"))
    found = study.shape(fine, coarse, options=AS_IT_LIES)
    assert found.statistics.mean_absolute == pytest.approx(0.309, abs=5e-4)
    assert found.statistics.largest == pytest.approx(2.461, abs=5e-4)


def test_a_scan_of_the_body_at_rest_is_compared_where_that_is_asked_for(tmp_path):
    cloud = write_csv(tmp_path / "scan.csv", MOTION(cylinder(20.0, 30.0, 300, 7)))
    with pytest.raises(RefusedError, match="another state: the body at rest fits it"):
        study.shape(problem(tmp_path), cloud)
    found = study.shape(problem(tmp_path), cloud, options=Options(any_state=True))
    assert found.statistics.rms > 0.5


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1e3, "um")])
def test_a_scan_in_another_unit_is_refused_and_the_unit_is_named(tmp_path, factor, unit):
    surface, _ = moved_egg(tmp_path)
    cloud = write_csv(tmp_path / "unit.csv", factor * scan(egg(), 500, np.random.default_rng(9)))
    with pytest.raises(InputError, match=f"is it in {unit}"):
        study.shape(surface, cloud)
    assert study.shape(surface, cloud, unit=unit).statistics.largest < 1e-3


@pytest.mark.parametrize("size", [0.1, 0.5, 2.0])
def test_a_scan_of_the_whole_body_in_another_size_is_refused(tmp_path, size):
    """In cm it lay within the body, "0.002 mm" from the surface with its sign."""
    points = size * MOTION(cylinder(RADIUS, HEIGHT, 400, 1))
    cloud = write_csv(tmp_path / "scan.csv", points)
    with pytest.raises(InputError, match="times as large: scaled it lies"):
        study.shape(problem(tmp_path), cloud)


def test_a_simulated_surface_with_a_hole_is_refused(tmp_path):
    whole = egg()
    holed = TriangleSurface(whole.points, whole.triangles[3:])
    cloud = write_csv(tmp_path / "scan.csv", scan(whole, 500, np.random.default_rng(10)))
    with pytest.raises(InputError, match=r"simulation: .*is not closed"):
        study.shape(write_ply(tmp_path / "holed.ply", holed), cloud)


def test_a_scan_with_holes_is_no_fault_and_what_it_shows_is_said(tmp_path):
    surface, _ = moved_egg(tmp_path)
    cloud = scan(egg(), 4000, np.random.default_rng(11))
    part = write_csv(tmp_path / "part.csv", MOTION(cloud[cloud[:, 0] > 0]))
    found = study.shape(surface, part)
    assert found.statistics.largest < 1e-3
    shown = egg().corners.mean(axis=1)[:, 0] > 0
    # the rim of what counts as seen is three spacings wide
    assert found.seen == pytest.approx(egg().areas[shown].sum() / egg().areas.sum(), abs=0.08)


@pytest.mark.parametrize(
    ("of_what", "content", "rule"),
    [
        ("scan", "x,y\n1,2\n", "no column 'z'"),
        ("scan", "x,y,z\n" + "1,2,nan\n" * 40, "must be a finite number"),
        ("scan", None, "there is no file"),
        ("markers", "x,y,z,x0\n1,2,3,4\n4,5,6,7\n7,8,9,1\n", "not all of x0, y0, z0"),
        ("markers", "x,y,z,x0,y0,z0\n" + "1,2,3,1,2,3\n" * 3, "says nothing of points inside"),
    ],
)
def test_a_faulty_cloud_or_faulty_markers_are_refused(tmp_path, of_what, content, rule):
    surface, cloud = moved_egg(tmp_path)
    if content is not None:
        (tmp_path / "faulty.csv").write_text(content)
    with pytest.raises(InputError, match=rule):
        study.shape(surface, **{"scan": cloud, of_what: tmp_path / "faulty.csv"})


def test_a_cloud_without_a_surface_is_refused(tmp_path):
    surface, _ = moved_egg(tmp_path)
    rng = np.random.default_rng(12)
    dense = scan(egg(), 550, rng) * [0.05, 1, 1]
    strewn = rng.uniform(-400, 400, (450, 3))
    with pytest.raises(InputError, match="stand alone: this is no surface"):
        study.shape(surface, write_csv(tmp_path / "dust.csv", np.vstack([dense, strewn])))


def test_points_without_weight_are_set_aside_and_counted(tmp_path):
    """A part of the table in the scan says nothing of the body, nor of its mean deviation."""
    surface, _ = moved_egg(tmp_path)
    rng = np.random.default_rng(12)
    body = scan(egg(), 2000, rng)
    noise = rng.normal(0, 0.002, body.shape)
    table = rng.uniform(-1.6, 1.6, (500, 3)) * egg().size / 2 + [0, 0, egg().size]
    cloud = write_csv(tmp_path / "table.csv", MOTION(np.vstack([body + noise, table])))
    found = study.shape(surface, cloud)
    assert found.statistics.set_aside + found.outliers == pytest.approx(500, abs=25)
    assert found.statistics.rms < 0.005
    assert found.statistics.largest_set_aside > 1
    said = " ".join(scan_answers(found))
    assert "without weight in the registration" in said


# Surfaces of meshes of every kind of cell: closed, outward, of the right volume.


def box_mesh(n, low, high, shape="tensor"):
    """Hexahedra or tetrahedra of a box."""
    x, y, z = np.linspace(low, high, n + 1).T
    return extrude(*rectangle(x, y, shape), z)


@pytest.mark.parametrize("kind", ["hexahedron", "tetra"])
def test_a_whole_box_has_its_volume(kind):
    shape = "tensor" if kind == "hexahedron" else "simplex"
    points, cells = box_mesh(3, [-2, -1, 0], [2, 1, 3], shape)
    mesh = DeformedMesh(points, 0.1 * points, kind, cells)
    found = surface_of(mesh)
    assert str(symmetry_of(mesh)) == "whole body"
    assert found.volume_mm3 == pytest.approx(24)
    deformed = TriangleSurface(found.points + found.displacement, found.triangles)
    assert deformed.volume_mm3 == pytest.approx(24 * 1.1**3)


def test_a_quarter_of_an_upper_half_becomes_the_whole():
    points, cells = box_mesh(2, [0, 0, 5], [2, 3, 10])
    stretch = np.array([0.1, 0.1, -0.2])
    mesh = DeformedMesh(points, (points - [0, 0, 5]) * stretch, "hexahedron", cells)
    found = surface_of(mesh)
    assert symmetry_of(mesh).mirrored == (True, True, True)
    assert found.volume_mm3 == pytest.approx(4 * 6 * 10)
    assert found.displacement[found.points[:, 2] == 0.0, 2] == pytest.approx(0.0)
    assert found.displacement[found.points[:, 2] == 10.0, 2] == pytest.approx(-2.0)


def test_a_scan_from_a_machine_whose_base_rests_is_compared_as_it_lies(tmp_path):
    """The surface was said to lie 3 mm higher: its middle rested, where both plates came closer."""
    cloud = cylinder(RADIUS, HEIGHT, 1000, 6) + [0, 0, HEIGHT / 2]
    scan = write_csv(tmp_path / "scan.csv", cloud)
    found = study.shape(problem(tmp_path), scan, options=AS_IT_LIES)
    assert found.statistics.rms < 0.006


def test_a_section_becomes_a_ring_of_the_right_volume():
    points = np.array([[1.0, 0, 0], [3, 0, 0], [3, 2, 0], [1, 2, 0]])
    mesh = DeformedMesh(points, np.zeros_like(points), "quad", np.array([[0, 1, 2, 3]]))
    found = surface_of(mesh)
    # a polygon of 180 sides has sin(2 deg) / (2 deg) of its circle's area
    share = np.sin(np.radians(2)) / np.radians(2)
    assert found.volume_mm3 == pytest.approx(16 * np.pi * share)


def test_unknown_cells_are_refused():
    mesh = DeformedMesh(np.eye(3), np.zeros((3, 3)), "wedge", np.zeros((1, 6), dtype=np.int64))
    with pytest.raises(InputError, match="cells of type 'wedge'"):
        surface_of(mesh)


def test_points_on_a_line_are_drawn_with_few_hexagons(tmp_path, monkeypatch):
    """A view that has no width got 2e10 rows of hexagons, and took all memory of the machine."""
    drawn = []
    hexbin = Axes.hexbin

    def watched(self, *arguments, gridsize, **look):
        drawn.append(gridsize)
        few = tuple(np.minimum(gridsize, 100).tolist())  # more would end the test, not the memory
        return hexbin(self, *arguments, gridsize=few, **look)

    monkeypatch.setattr(Axes, "hexbin", watched)
    height = np.linspace(2, 28, 200)  # a line on the side of the cylinder, seen from the front
    angle = 1e-9 * np.sin(height)
    line = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height])
    scan = write_csv(tmp_path / "scan.csv", line)
    study.shape(problem(tmp_path), scan, options=Options(False, True), reports=tmp_path / "r")
    assert drawn
    assert max(across * up for across, up in drawn) <= 40 * len(line)
