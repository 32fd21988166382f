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
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from study.ground.arrays import Array, Elements, Flags, Ints, Unknowns
from study.ground.compilation import kernel
from study.mechanics.element.assembly import Shapes
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.setup import Model

#: coordinates closer than this fraction of the height are the same
_SAME = 1e-9


@dataclass(frozen=True)
class Nodes:
    """Places that boundary conditions are laid on."""

    #: shape (n_nodes, dim); reference positions; a bubble sits at its element's centroid.
    nodes: Array

    @property
    def dim(self) -> int:
        """Number of displacement components."""
        return int(self.nodes.shape[1])


def at_level(space: Nodes, mesh: Mesh, level: float) -> Ints:
    """Nodes at an axial position. Shapes: level mm; returns (n,)."""
    return np.flatnonzero(np.abs(space.nodes[:, -1] - level) < _SAME * mesh.height_mm)


def middle_nodes(space: Nodes, members: Ints, ends: Ints) -> Ints:
    """Node of each cell or facet that lies in the middle of some of its corners, shape (n,).

    Shapes: members (n, k), the nodes to choose from; ends (n, m).
    """
    halfway = space.nodes[ends].mean(axis=1)
    apart = np.linalg.norm(space.nodes[members] - halfway[:, None], axis=2)
    return np.asarray(members[np.arange(len(members)), apart.argmin(axis=1)])


def _side_facets(space: Discretization, mesh: Mesh) -> Flags:
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
#: order of the quadrature rule, of simplices by the space, of others by the order
_SIMPLEX_RULES = {"axisymmetric": 4, "3d": 2}
_TENSOR_RULES = {"linear": 3, "quadratic": 5}
#: and under an indenter, where a quadratic tetrahedron is stretched five times: looked at in
#: four points only, it collapses between them
_STRETCHED_RULE = 5


@dataclass(frozen=True)
class Discretization(Nodes):
    """Everything that the element loops need, computed once per mesh."""

    #: shape (n_elements, n_local); nodes of each element.
    element_nodes: Ints
    #: shape (n_elements, m); unknowns of each element: displacements node by node, then pressures.
    dofs: NDArray[np.int32]
    #: Numbers of displacement unknowns and of all unknowns.
    n_displacement: int
    n: int
    gradients: Array
    hoop: Array
    pressure_shape: Array
    weights: Array
    #: shape (n_facets, k); nodes of each boundary facet (edges or faces), midpoints included.
    facets: Ints
    #: shape (n_facets,); area of each boundary facet in mm^2 (2 pi r times length in axisymmetric
    #: space).
    facet_weights: Array

    @property
    def shapes(self) -> Shapes:
        """What compiled loops take of it."""
        return Shapes(self.gradients, self.hoop, self.pressure_shape, self.weights, self.dofs)

    def pressures(self, x: Array) -> Array:
        """Pressure at every quadrature point, shape (n_elements, n_quadrature). Shapes: x (n,)."""
        dofs = self.dofs[:, self.dim * self.element_nodes.shape[1] :]
        shape = np.broadcast_to(self.pressure_shape, (*self.weights.shape, dofs.shape[1]))
        return np.asarray(np.einsum("eqk,ek->eq", shape, x[dofs]))

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.element_nodes.shape[0])


def discretize(mesh: Mesh, model: Model, *, stretched: bool = False) -> Discretization:
    """Shape-function arrays of a mesh for a model's element pair."""
    axisymmetric, simplex = model.space == "axisymmetric", model.element_shape == "simplex"
    rule = _SIMPLEX_RULES[model.space] if simplex else _TENSOR_RULES[model.element_order]
    if stretched and simplex and not axisymmetric and model.element_order == "quadratic":
        rule = _STRETCHED_RULE
    basis = basis_of(mesh, model, rule)
    dim, (ne, nq) = mesh.points.shape[1], basis.dx.shape
    gradients = np.stack([np.broadcast_to(b[0].grad, (dim, ne, nq)) for b in basis.basis])
    values = np.stack([np.broadcast_to(np.asarray(b[0]), (ne, nq)) for b in basis.basis])
    # one memory layout in both spaces: another would be compiled a second time
    weights, hoop = np.array(basis.dx), np.zeros((ne, nq, 1))
    if axisymmetric:
        radius = np.asarray(basis.global_coordinates())[0]
        weights = weights * 2 * np.pi * radius
        hoop = np.ascontiguousarray((values / radius).transpose(1, 2, 0))
    element_nodes = basis.element_dofs.T.astype(np.int64)
    nodes = np.array(basis.doflocs.T)
    pressure_shape, pressure_dofs = pressure_of(basis, model)
    displacement = (dim * element_nodes[:, :, None] + np.arange(dim)).reshape(ne, -1)
    n_u = int(dim * len(nodes))
    n_p = int(pressure_dofs.max()) + 1 if pressure_dofs.size else 0
    facets, areas = _facets(basis, nodes)
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
    """Integral of every shape function of the displacements, shape (n_nodes,), mm^3."""
    # of higher degree than any product of a shape function, a radius and a Jacobian
    basis = basis_of(mesh, model, 6)
    weights = np.array(basis.dx)
    if model.space == "axisymmetric":
        weights = weights * 2 * np.pi * np.asarray(basis.global_coordinates())[0]
    volumes = np.zeros(basis.N)
    for element_nodes, (shape, *_) in zip(basis.element_dofs, basis.basis, strict=True):
        np.add.at(volumes, element_nodes, (np.asarray(shape) * weights).sum(axis=1))
    return volumes


def interpolation(mesh: Mesh, model: Model, places: Array) -> Callable[[Array], Array]:
    """Make the function that takes values at the nodes to places within the elements."""
    # Shapes: places (m, dim), mm.
    shapes = basis_of(mesh, model, 1).probes(np.ascontiguousarray(places.T))
    return lambda values: np.asarray(shapes @ values)


def basis_of(mesh: Mesh, model: Model, order: int) -> Any:
    """Scalar basis of one displacement component, with a quadrature of some order."""
    import skfem

    simplex, cells = model.element_shape == "simplex", mesh.cells
    stem = {"axisymmetric": ("Tri", "Quad"), "3d": ("Tet", "Hex")}[model.space][not simplex]
    if stem == "Hex":
        cells = cells[:, _HEX_ORDER]
    points, corners = (np.ascontiguousarray(rows.T) for rows in (mesh.points, cells))
    fem_mesh = getattr(skfem, f"Mesh{stem}")(points, corners)
    degree = "2" if model.element_order == "quadratic" else "1"
    bubbles = simplex and degree == "1" and model.formulation == "mixed"
    if simplex:
        degree = "Mini" if bubbles else f"P{degree}"
    basis = skfem.Basis(fem_mesh, getattr(skfem, f"Element{stem}{degree}")(), intorder=order)
    if bubbles:  # scikit-fem gives them no place
        basis.doflocs[:, basis.interior_dofs[-1]] = mesh.points[mesh.cells].mean(axis=1).T
    return basis


def pressure_of(basis: Any, model: Model) -> tuple[Array, Ints]:
    """Pressure shape functions at the quadrature of a basis, and their element-wise numbers."""
    import skfem

    ne, nq = basis.dx.shape
    if model.formulation == "displacement":
        return np.zeros((1, nq, 0)), np.zeros((ne, 0), dtype=np.int64)
    if model.element_shape == "simplex":
        two = basis.mesh.dim() == 2
        pair = basis.with_element(skfem.ElementTriP1() if two else skfem.ElementTetP1())
        shape = np.stack([np.asarray(b[0])[0] for b in pair.basis], axis=-1)
        return np.ascontiguousarray(shape[None]), pair.element_dofs.T.astype(np.int64)
    if model.element_order == "linear":
        return np.ones((1, nq, 1)), np.arange(ne)[:, None]
    # 1 and the coordinates about the element's centroid, divided by its size
    x = np.asarray(basis.global_coordinates())  # (dim, ne, nq)
    corners = basis.mesh.p[:, basis.mesh.t]  # (dim, vertices, ne)
    center, size = corners.mean(axis=1)[:, :, None], np.ptp(corners, axis=1)[:, :, None]
    shape = np.concatenate([np.ones((1, *x.shape[1:])), (x - center) / size])
    k = shape.shape[0]
    return np.ascontiguousarray(shape.transpose(1, 2, 0)), np.arange(k * ne).reshape(ne, k)


def _facets(basis: Any, nodes: Array) -> tuple[Ints, Array]:
    """Nodes and areas of the boundary facets."""
    fem_mesh = basis.mesh
    facets = fem_mesh.boundary_facets()
    vertices = basis.nodal_dofs[0][fem_mesh.facets[:, facets]].T
    parts = [vertices]
    if basis.edge_dofs.size and fem_mesh.dim() == 3:
        parts.append(basis.edge_dofs[0][fem_mesh.f2e[:, facets]].T)
    if basis.facet_dofs.size:
        parts.append(basis.facet_dofs[0][facets][:, None])
    return np.hstack(parts).astype(np.int64), facet_areas(nodes[vertices])


def facet_areas(corners: Array) -> Array:
    """Areas from the corner positions, shape (n_facets, corners, dim); of rings in a plane."""
    if corners.shape[2] == 2:
        length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        return np.asarray(length * (2 * np.pi * corners[:, :, 0].mean(axis=1)))
    a = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(a, axis=1) / 2
    if corners.shape[1] == 4:  # scikit-fem orders a quadrilateral facet around its rim
        b = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 0])
        area = area + np.linalg.norm(b, axis=1) / 2
    return np.asarray(area)


def deformation_gradient(space: Discretization, u: Array) -> Array:
    """F at every quadrature point, shape (3, 3, n_elements, n_quadrature); u (n_nodes, dim), mm."""
    local, dim = u[space.element_nodes], space.dim
    F = np.zeros((3, 3, *space.weights.shape))
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[:dim, :dim] += np.einsum("eai,eqaj->ijeq", local, space.gradients)
    if dim == 2:
        F[2, 2] += np.einsum("ea,eqa->eq", local[:, :, 0], space.hoop)
    return F


# Fixed sparsity pattern of the free unknowns, and the map that scatters element tangents into it.


@dataclass(frozen=True)
class Pattern:
    """Upper triangle, in compressed rows, of the matrix of the free unknowns."""

    #: shape (n_free,); unknowns that are solved for, ascending.
    free: NDArray[np.int64]
    #: shape (n,); row of each unknown among the free ones, -1 where constrained.
    number: NDArray[np.int32]
    #: Compressed rows with sorted columns and an entry on every diagonal.
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    #: shape (n_elements, m (m + 1) / 2); where each packed element entry goes; -1 where a
    #: constrained unknown takes part.
    positions: NDArray[np.int32]

    @classmethod
    def build(cls, dofs: NDArray[np.int32], n: int, constrained: NDArray[np.int64]) -> Pattern:
        """Pattern of the elements' unknowns ``dofs`` (n_elements, m) without the constrained."""
        free = np.setdiff1d(np.arange(n), constrained)
        number = np.full(n, -1, dtype=np.int32)
        number[free] = np.arange(free.size, dtype=np.int32)
        rows = number[dofs]
        inside = rows >= 0
        ends = np.concatenate([[0], np.cumsum(inside.sum(axis=1))])
        elements = sp.csr_matrix(
            (np.ones(ends[-1], np.int32), rows[inside], ends), (len(dofs), free.size)
        )
        met = sp.triu(elements.T @ elements, format="csr")
        met.sort_indices()
        indptr, indices = met.indptr.astype(np.int32), met.indices.astype(np.int32)
        return cls(free, number, indptr, indices, _located(indptr, indices, rows))

    def locate(self, dofs: NDArray[np.int64]) -> NDArray[np.int32]:
        """Positions of the packed upper entries of small blocks, shape (n_blocks, m(m+1)/2)."""
        # Every pair must already share an element, as the nodes of a face do.
        return np.asarray(_located(self.indptr, self.indices, self.number[dofs]))


@kernel()
def _located(indptr: Unknowns, indices: Unknowns, rows: Unknowns) -> Unknowns:
    """Where the packed upper entries of blocks are; ``rows`` (n_blocks, m) are negative if held."""
    m = rows.shape[1]
    out = np.full((rows.shape[0], m * (m + 1) // 2), -1, np.int32)
    for e in range(rows.shape[0]):
        s = 0
        for i in range(m):
            for j in range(i, m):
                low, high = min(rows[e, i], rows[e, j]), max(rows[e, i], rows[e, j])
                if low >= 0:
                    a, b = indptr[low], indptr[low + 1]
                    k = a + np.searchsorted(indices[a:b], high)
                    if k < b and indices[k] == high:
                        out[e, s] = k
                s += 1
    return out


@kernel()
def symmetric_product(indptr: Unknowns, indices: Unknowns, data: Array, v: Array) -> Array:
    """Multiply the symmetric matrix of an upper triangle in compressed rows by a vector.

    Shapes: data (n_entries,); v (n,).
    """
    out = np.zeros(v.size)
    for i in range(v.size):
        k = indptr[i]
        total = data[k] * v[i]  # rows begin with their diagonal
        for k in range(indptr[i] + 1, indptr[i + 1]):
            j = indices[k]
            total += data[k] * v[j]
            out[j] += data[k] * v[i]
        out[i] += total
    return out


Slabs = tuple[Elements, ...]
#: quadrature points of a slab that are worth a thread's while, and numbers of slabs: two, four or
#: eight threads have the same work
_WORTH = 5_000
_COUNTS = (16, 8, 4)


def slabs(space: Discretization) -> tuple[Slabs, ...]:
    """Elements in phases, each of them slabs across the body that share no unknown."""
    # Of the ways across the body that one is taken along which elements are numbered, as far as
    # they are: memory is then read in a row. Where a mesh is too coarse somewhere for slabs, two
    # halves come first and the elements between them afterwards.
    places = space.nodes[space.element_nodes].mean(axis=1).T
    for count in _COUNTS:
        if space.weights.size >= count * _WORTH:
            cuts = [(cut[::2], cut[1::2]) for cut in (_cut(x, count) for x in places)]
            separating = [cut for cut in cuts if all(_apart(phase, space) for phase in cut)]
            if separating:
                return min(separating, key=_gaps)
    if space.weights.size >= 2 * _WORTH:
        halves = [_halves(_cut(x, 2), space) for x in places]
        return min(halves, key=lambda phases: phases[1][0].size)
    return ((np.arange(space.n_elements, dtype=np.uint32),),)


def _cut(x: Array, count: int) -> Slabs:
    """Slabs of as many elements along ``x``, shape (n_elements,)."""
    slab = np.empty(x.size, dtype=np.int64)
    slab[np.argsort(x, kind="stable")] = count * np.arange(x.size) // x.size
    return tuple(np.flatnonzero(slab == i).astype(np.uint32) for i in range(count))


def _halves(cut: Slabs, space: Discretization) -> tuple[Slabs, ...]:
    """Two slabs, the second without what it shares unknowns with the first, which comes after."""
    first, second = cut
    met = np.zeros(space.n, dtype=bool)
    met[space.dofs[first].ravel()] = True
    between = met[space.dofs[second]].any(axis=1)
    return (first, second[~between]), (second[between],)


def _gaps(phases: tuple[Slabs, ...]) -> int:
    """Where the elements of a slab are not numbered in a row."""
    steps = (np.diff(slab.astype(np.int64)) for phase in phases for slab in phase)
    return sum(int(np.count_nonzero(step != 1)) for step in steps)


def _apart(phase: Slabs, space: Discretization) -> bool:
    """Whether no two slabs share an unknown."""
    met = np.zeros(space.n, dtype=bool)
    for elements in phase:
        dofs = space.dofs[elements].ravel()
        if met[dofs].any():
            return False
        met[dofs] = True
    return True
