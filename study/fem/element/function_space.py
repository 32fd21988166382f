"""Element pairs: shape-function arrays for the kernels, from scikit-fem's bases.

================  ==========================  =========================
order             simplex                     tensor
================  ==========================  =========================
quadratic, mixed  P2 / P1 (Taylor-Hood)       Q2 / discontinuous P1
linear, mixed     P1 + bubble / P1 (MINI)     Q1 / P0 (not inf-sup stable)
displacement      P2 or P1                    Q2 or Q1
================  ==========================  =========================

Taylor-Hood and MINI satisfy the inf-sup condition (Boffi, Brezzi, Fortin 2013, secs 8.4, 8.8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array, Ints
from study.fem.element.assembly import Shapes
from study.fem.mesh.mesh import Mesh
from study.setup.setup import Model

#: coordinates closer than this fraction of the height are the same
_SAME = 1e-9


class Nodes(Protocol):
    """Places that boundary conditions are laid on."""

    @property
    def nodes(self) -> Array:
        """Reference positions, shape (n_nodes, dim)."""

    @property
    def dim(self) -> int:
        """Number of displacement components."""


def at_level(space: Nodes, mesh: Mesh, level: float) -> Ints:
    """Nodes at an axial position.

    Parameters
    ----------
    space : Nodes
        Whose last coordinate is the axial one.
    mesh : Mesh
        Nodes within 1e-9 of its height count as on the level.
    level : float
        In mm.

    Returns
    -------
    ndarray of int, shape (n,)
        Numbers of the nodes, ascending.
    """
    return np.flatnonzero(np.abs(space.nodes[:, -1] - level) < _SAME * mesh.height_mm)


def _top_facets(space: Discretization, mesh: Mesh) -> NDArray[np.bool_]:
    axial = space.nodes[space.facets][:, :, -1]
    return np.asarray((np.abs(axial - mesh.height_mm) < _SAME * mesh.height_mm).all(axis=1))


def _side_facets(space: Discretization, mesh: Mesh) -> NDArray[np.bool_]:
    """Boundary facets that lie neither on a plate, nor on a plane of symmetry."""
    height = mesh.height_mm
    planes = [(space.dim - 1, height), (space.dim - 1, height / 2 if mesh.half_height else 0.0)]
    planes += [(i, 0.0) for i in range(space.dim - 1)]
    side = np.ones(len(space.facets), dtype=bool)
    for axis, value in planes:
        level = space.nodes[space.facets][:, :, axis]
        side &= ~(np.abs(level - value) < _SAME * height).all(axis=1)
    return side


#: scikit-fem's numbering of the corners of a hexahedron, seen from (bottom quad, top quad)
_HEX_ORDER = [0, 4, 3, 1, 7, 5, 2, 6]

#: order of the quadrature rule of (space, order, shape)
_RULES = {
    ("axisymmetric", "quadratic", "simplex"): 4,
    ("axisymmetric", "linear", "simplex"): 4,
    ("axisymmetric", "quadratic", "tensor"): 5,
    ("axisymmetric", "linear", "tensor"): 3,
    ("3d", "quadratic", "simplex"): 2,
    ("3d", "linear", "simplex"): 2,
    ("3d", "quadratic", "tensor"): 5,
    ("3d", "linear", "tensor"): 3,
}

#: and under an indenter, where a quadratic tetrahedron is stretched five times: looked at in
#: four points only, it collapses between them
_STRETCHED_RULES = {("3d", "quadratic", "simplex"): 5}


@dataclass(frozen=True)
class Discretization:
    """Everything that the element loops need, computed once per mesh.

    Parameters
    ----------
    nodes : ndarray, shape (n_nodes, dim)
        Reference positions; a bubble sits at its element's centroid.
    element_nodes : ndarray of int, shape (n_elements, n_local)
        Nodes of each element.
    dofs : ndarray of int32, shape (n_elements, m)
        Unknowns of each element: displacements node by node, then pressures.
    n_displacement, n : int
        Numbers of displacement unknowns and of all unknowns.
    gradients, hoop, pressure_shape, weights : ndarray
        As :class:`study.fem.element.assembly.Shapes` takes them.
    facets : ndarray of int, shape (n_facets, k)
        Nodes of each boundary facet (edges or faces), midpoints included.
    facet_weights : ndarray, shape (n_facets,)
        Area of each boundary facet in mm^2 (2 pi r times length in axisymmetric space).
    """

    nodes: Array
    element_nodes: Ints
    dofs: NDArray[np.int32]
    n_displacement: int
    n: int
    gradients: Array
    hoop: Array
    pressure_shape: Array
    weights: Array
    facets: Ints
    facet_weights: Array

    @property
    def dim(self) -> int:
        """Number of displacement components."""
        return int(self.nodes.shape[1])

    @property
    def shapes(self) -> Shapes:
        """What compiled loops take of it."""
        return Shapes(self.gradients, self.hoop, self.pressure_shape, self.weights, self.dofs)

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.element_nodes.shape[0])


def discretize(mesh: Mesh, model: Model, *, stretched: bool = False) -> Discretization:
    """Shape-function arrays of a mesh for a model's element pair.

    Parameters
    ----------
    mesh : Mesh
        Of the cells that the model's space and element shape ask for.
    model : Model
        Its space, element order, element shape and formulation count.
    stretched : bool
        Whether single places are stretched several times, as under an indenter.
    """
    from skfem import Basis

    axisymmetric = model.space == "axisymmetric"
    fem_mesh = _fem_mesh(mesh, axisymmetric, model.element_shape)
    element = _displacement_element(model, axisymmetric)
    rules = _RULES | _STRETCHED_RULES if stretched else _RULES
    rule = rules[(model.space, model.element_order, model.element_shape)]
    basis = Basis(fem_mesh, element, intorder=rule)
    ne, nq = basis.dx.shape
    gradients = np.stack(
        [np.broadcast_to(b[0].grad, (mesh.points.shape[1], ne, nq)) for b in basis.basis]
    )
    values = np.stack([np.broadcast_to(np.asarray(b[0]), (ne, nq)) for b in basis.basis])
    # one memory layout in both spaces: another would be compiled a second time
    weights, hoop = np.array(basis.dx), np.zeros((ne, nq, 1))
    if axisymmetric:
        radius = np.asarray(basis.global_coordinates())[0]
        weights = weights * 2 * np.pi * radius
        hoop = np.ascontiguousarray((values / radius).transpose(1, 2, 0))
    element_nodes = basis.element_dofs.T.astype(np.int64)
    nodes = _node_positions(basis, mesh)
    pressure_shape, pressure_dofs = _pressure(fem_mesh, basis, model)
    dim = mesh.points.shape[1]
    displacement = (dim * element_nodes[:, :, None] + np.arange(dim)).reshape(ne, -1)
    n_u = int(dim * len(nodes))
    n_p = int(pressure_dofs.max()) + 1 if pressure_dofs.size else 0
    facets, areas = _facets(fem_mesh, basis, nodes, axisymmetric)
    return Discretization(
        nodes=nodes,
        element_nodes=element_nodes,
        dofs=np.hstack([displacement, n_u + pressure_dofs]).astype(np.int32),
        n_displacement=n_u,
        n=n_u + n_p,
        gradients=np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)),
        hoop=hoop,
        pressure_shape=pressure_shape,
        weights=np.ascontiguousarray(weights),
        facets=facets,
        facet_weights=areas,
    )


def nodal_volumes(mesh: Mesh, model: Model) -> Array:
    """Integral of every shape function of the displacements, shape (n_nodes,), mm^3.

    Parameters
    ----------
    mesh : Mesh
        Of a space made by :func:`discretize` for the same model.
    model : Model
        Its elements.

    Returns
    -------
    ndarray, shape (n_nodes,)
        2 pi r times the area in axisymmetric space; their sum is the volume, bubbles left out.
    """
    from skfem import Basis

    axisymmetric = model.space == "axisymmetric"
    fem_mesh = _fem_mesh(mesh, axisymmetric, model.element_shape)
    # of higher degree than any product of a shape function, a radius and a Jacobian
    basis = Basis(fem_mesh, _displacement_element(model, axisymmetric), intorder=6)
    weights = np.array(basis.dx)
    if axisymmetric:
        weights = weights * 2 * np.pi * np.asarray(basis.global_coordinates())[0]
    volumes = np.zeros(basis.N)
    for own, (shape, *_) in zip(basis.element_dofs, basis.basis, strict=True):
        np.add.at(volumes, own, (np.asarray(shape) * weights).sum(axis=1))
    return volumes


def interpolation(mesh: Mesh, model: Model, places: Array) -> Callable[[Array], Array]:
    """Make the function that takes values at the nodes to places within the elements.

    Parameters
    ----------
    mesh : Mesh
        Of a space made by :func:`discretize` for the same model.
    model : Model
        Its elements.
    places : ndarray, shape (m, dim)
        Inside the mesh, mm.

    Returns
    -------
    callable
        Values (n_nodes, k) to values (m, k), as exact as the elements themselves.

    Raises
    ------
    ValueError
        If a place lies outside.
    """
    from skfem import Basis

    axisymmetric = model.space == "axisymmetric"
    fem_mesh = _fem_mesh(mesh, axisymmetric, model.element_shape)
    basis = Basis(fem_mesh, _displacement_element(model, axisymmetric), intorder=1)
    shapes = basis.probes(np.ascontiguousarray(places.T))
    return lambda values: np.asarray(shapes @ values)


def _node_positions(basis: Any, mesh: Mesh) -> Array:
    nodes = np.array(basis.doflocs.T)
    bubbles = np.asarray(basis.interior_dofs)
    if np.isnan(nodes).any():  # scikit-fem gives bubbles no place
        nodes[bubbles[-1]] = mesh.points[mesh.cells].mean(axis=1)
    return nodes


def _fem_mesh(mesh: Mesh, axisymmetric: bool, shape: str) -> Any:
    import skfem

    kinds = {
        (True, "simplex"): skfem.MeshTri,
        (True, "tensor"): skfem.MeshQuad,
        (False, "simplex"): skfem.MeshTet,
        (False, "tensor"): skfem.MeshHex,
    }
    cells = mesh.cells
    if not axisymmetric and shape == "tensor":
        cells = cells[:, _HEX_ORDER]
    kind = kinds[(axisymmetric, shape)]
    return kind(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(cells.T))


def _displacement_element(model: Model, axisymmetric: bool) -> Any:
    import skfem

    names = {
        ("quadratic", "simplex"): ("ElementTriP2", "ElementTetP2"),
        ("quadratic", "tensor"): ("ElementQuad2", "ElementHex2"),
        ("linear", "simplex"): ("ElementTriMini", "ElementTetMini"),
        ("linear", "tensor"): ("ElementQuad1", "ElementHex1"),
    }[(model.element_order, model.element_shape)]
    if (model.formulation, model.element_order, model.element_shape) == (
        "displacement",
        "linear",
        "simplex",
    ):
        names = ("ElementTriP1", "ElementTetP1")
    return getattr(skfem, names[0 if axisymmetric else 1])()


def _pressure(fem_mesh: Any, basis: Any, model: Model) -> tuple[Array, Ints]:
    """Pressure shape functions and their element-wise numbers."""
    import skfem

    ne, nq = basis.dx.shape
    if model.formulation == "displacement":
        return np.zeros((1, nq, 0)), np.zeros((ne, 0), dtype=np.int64)
    if model.element_shape == "simplex":
        two = fem_mesh.dim() == 2
        pair = basis.with_element(skfem.ElementTriP1() if two else skfem.ElementTetP1())
        shape = np.stack([np.asarray(b[0])[0] for b in pair.basis], axis=-1)
        return np.ascontiguousarray(shape[None]), pair.element_dofs.T.astype(np.int64)
    if model.element_order == "linear":
        return np.ones((1, nq, 1)), np.arange(ne)[:, None]
    return _discontinuous_linear(fem_mesh, basis)


def _discontinuous_linear(fem_mesh: Any, basis: Any) -> tuple[Array, Ints]:
    """1 and the coordinates about the element's centroid, divided by its size."""
    x = np.asarray(basis.global_coordinates())  # (dim, ne, nq)
    corners = fem_mesh.p[:, fem_mesh.t]  # (dim, vertices, ne)
    center = corners.mean(axis=1)[:, :, None]
    size = np.ptp(corners, axis=1)[:, :, None]
    shape = np.concatenate([np.ones((1, *x.shape[1:])), (x - center) / size])
    ne, k = x.shape[1], shape.shape[0]
    return np.ascontiguousarray(shape.transpose(1, 2, 0)), np.arange(k * ne).reshape(ne, k)


def _facets(fem_mesh: Any, basis: Any, nodes: Array, axisymmetric: bool) -> tuple[Ints, Array]:
    """Nodes and areas of the boundary facets."""
    facets = fem_mesh.boundary_facets()
    vertices = basis.nodal_dofs[0][fem_mesh.facets[:, facets]].T
    parts = [vertices]
    if basis.edge_dofs.size and fem_mesh.dim() == 3:
        parts.append(basis.edge_dofs[0][fem_mesh.f2e[:, facets]].T)
    if basis.facet_dofs.size:
        parts.append(basis.facet_dofs[0][facets][:, None])
    areas = _facet_areas(nodes[vertices], axisymmetric)
    return np.hstack(parts).astype(np.int64), areas


def _facet_areas(corners: Array, axisymmetric: bool) -> Array:
    """Areas from the corner positions, shape (n_facets, corners, dim)."""
    if corners.shape[2] == 2:
        length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        around = 2 * np.pi * corners[:, :, 0].mean(axis=1) if axisymmetric else 1.0
        return np.asarray(length * around)
    a = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(a, axis=1) / 2
    if corners.shape[1] == 4:  # scikit-fem orders a quadrilateral facet around its rim
        b = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])
        area = area + np.linalg.norm(b, axis=1) / 2
    return np.asarray(area)


def deformation_gradient(space: Discretization, u: Array) -> Array:
    """F at every quadrature point, shape (3, 3, n_elements, n_quadrature).

    Parameters
    ----------
    space : Discretization
        Of the nodes of ``u``.
    u : ndarray, shape (n_nodes, dim)
        Displacements, mm.
    """
    local, dim = u[space.element_nodes], space.dim
    F = np.zeros((3, 3, *space.weights.shape))
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[:dim, :dim] += np.einsum("eai,eqaj->ijeq", local, space.gradients)
    if dim == 2:
        F[2, 2] += np.einsum("ea,eqa->eq", local[:, :, 0], space.hoop)
    return F
