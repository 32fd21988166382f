"""A material with numbers: an energy, its constants and its compressibility."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.errors import Fault, InputError, nearest
from study.material.energy import Energy, Family, energy, index_pair


@dataclass(frozen=True)
class Material:
    """One material; exactly one of the three ways to give its compressibility.

    Parameters
    ----------
    model : str
        Name of the energy (see :data:`study.material.MODELS`).
    constants : mapping of str to float
        Constants in MPa (exponents plain), put in the energy's own order.
    bulk_modulus : float, optional
        K in MPa, of U = K/2 (J - 1)^2.
    poisson_ratio : float, optional
        Initial Poisson's ratio; K then follows mu0 whenever the constants change.
    incompressible : bool
        K is infinite.

    Raises
    ------
    InputError
        If a constant is unknown, missing or not finite, or the compressibility is not given
        exactly once and in its range. Values that merely make an unstable material are let
        through, because a fit may pass over them: see :func:`study.material.check`.
    """

    model: str
    constants: Mapping[str, float]
    bulk_modulus: float | None = None
    poisson_ratio: float | None = None
    incompressible: bool = False

    def __post_init__(self) -> None:
        declared = energy(self.model)
        faults = [*_constant_faults(declared, self.constants), *_compressibility_faults(self)]
        if faults:
            raise InputError(faults)
        names = _ordered(declared, self.constants)
        object.__setattr__(self, "constants", {n: float(self.constants[n]) for n in names})

    @property
    def family(self) -> Family:
        """Which formula computes the energy."""
        return energy(self.model).family

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the constants, in order."""
        return tuple(self.constants)

    @property
    def values(self) -> Array:
        """Constants as an array, shape (p,), in the order of :attr:`names`."""
        return np.array(list(self.constants.values()))

    @property
    def mu0(self) -> float:
        """Initial shear modulus in MPa: 2 (C10 + C01), sum mu_i, or E / 2(1 + nu)."""
        if self.family == "linear-elastic":
            return self._linear_shear_modulus()
        return float(sum(w * self.constants[n] for n, w in self.mu0_gradient().items()))

    def mu0_gradient(self) -> dict[str, float]:
        """Differentiate mu0 with respect to every constant."""
        if self.family == "linear-elastic":
            modulus, mu = self.constants["youngs_modulus"], self.mu0
            if self.bulk_modulus is not None:  # 1/mu = 3/E - 1/(3K)
                return {"youngs_modulus": 3 * (mu / modulus) ** 2}
            return {"youngs_modulus": mu / modulus}
        if self.family == "ogden":
            return {n: 1.0 if n.startswith("mu") else 0.0 for n in self.constants}
        return {n: 2.0 if n in ("C10", "C01") else 0.0 for n in self.constants}

    @property
    def bulk(self) -> float:
        """Bulk modulus K in MPa; infinite if incompressible."""
        if self.incompressible:
            return math.inf
        if self.bulk_modulus is not None:
            return self.bulk_modulus
        return self._bulk_per_mu() * self.mu0

    def bulk_gradient(self) -> dict[str, float]:
        """dK/dconstant: zero unless K follows mu0 at a given Poisson's ratio."""
        if self.poisson_ratio is None:
            return dict.fromkeys(self.constants, 0.0)
        return {n: self._bulk_per_mu() * g for n, g in self.mu0_gradient().items()}

    def coefficient_table(self) -> Array:
        """Coefficients C_ij of the polynomial family in MPa, shape (ni + 1, nj + 1)."""
        pairs = {name: index_pair(name) for name in self._require("polynomial")}
        table = np.zeros(
            (1 + max(i for i, _ in pairs.values()), 1 + max(j for _, j in pairs.values()))
        )
        for name, pair in pairs.items():
            table[pair] = self.constants[name]
        return table

    def table_index(self, name: str) -> tuple[int, int]:
        """Place (i, j) of a constant in :meth:`coefficient_table`."""
        self._require("polynomial")
        return index_pair(name)

    def ogden_terms(self) -> tuple[Array, Array]:
        """Moduli mu_i (MPa) and exponents alpha_i of the Ogden family, each shape (n,)."""
        values = np.array([self.constants[n] for n in self._require("ogden")])
        return values[0::2].copy(), values[1::2].copy()

    def with_constants(self, constants: Mapping[str, float] | ArrayLike) -> Material:
        """Return the same material with other constants: a mapping, or values in order."""
        if isinstance(constants, Mapping):
            return replace(self, constants={**self.constants, **constants})
        values = np.asarray(constants, dtype=float)
        if values.shape != (len(self.names),):
            raise InputError(f"{self.model} takes {len(self.names)} constants, got {values.size}")
        return replace(self, constants=dict(zip(self.names, values.tolist(), strict=True)))

    def _bulk_per_mu(self) -> float:
        nu = self.poisson_ratio
        return math.inf if nu is None else 2 * (1 + nu) / (3 * (1 - 2 * nu))

    def _linear_shear_modulus(self) -> float:
        modulus = self.constants["youngs_modulus"]
        if self.bulk_modulus is not None:
            return 3 * self.bulk_modulus * modulus / (9 * self.bulk_modulus - modulus)
        return modulus / (2 * (1 + (0.5 if self.poisson_ratio is None else self.poisson_ratio)))

    def _require(self, family: Family) -> tuple[str, ...]:
        if self.family != family:
            raise ValueError(f"{self.model} is not of the {family} family")
        return self.names


def _constant_faults(declared: Energy, constants: Mapping[str, float]) -> list[Fault]:
    faults = []
    for name, value in constants.items():
        if not re.fullmatch(declared.grammar, name):
            valid = nearest(name, declared.names(2 if declared.open_ended else 1))
            faults.append(Fault(f"material.{name}", f"is no constant of {declared.name}", valid))
        elif not math.isfinite(value):
            faults.append(Fault(f"material.{name}", f"must be finite, got {value}"))
    if not faults and not declared.sparse:
        for name in _complete(declared, constants):
            if name not in constants:
                rule = f"{declared.name} needs it: got {', '.join(constants) or 'none'}"
                faults.append(Fault(f"material.{name}", rule))
    if not faults and not constants:
        faults.append(Fault("material", f"{declared.name} needs at least one constant"))
    return faults


def _complete(declared: Energy, constants: Mapping[str, float]) -> tuple[str, ...]:
    """Names that go with the highest term present."""
    if not declared.open_ended:
        return declared.names(1)
    terms = [1]
    for name in constants:
        digits = re.sub(r"\D", "", name)
        terms.append(index_pair(name)[0] if declared.family == "polynomial" else int(digits))
    return declared.names(max(terms))


def _ordered(declared: Energy, constants: Mapping[str, float]) -> Sequence[str]:
    if not declared.sparse:
        return _complete(declared, constants)

    def rank(name: str) -> tuple[int, int]:
        i, j = index_pair(name)
        return i + j, j

    return sorted(constants, key=rank)


def _compressibility_faults(material: Material) -> list[Fault]:
    bulk, nu = material.bulk_modulus, material.poisson_ratio
    given = (bulk is not None) + (nu is not None) + bool(material.incompressible)
    if given != 1:
        rule = "give exactly one of bulk_modulus, poisson_ratio and incompressible = true"
        return [Fault("material", f"{rule}; got {given}")]
    if bulk is not None and not (math.isfinite(bulk) and bulk > 0):
        return [Fault("material.bulk_modulus", f"must be positive and finite, got {bulk}")]
    if nu is not None and not -1 < nu < 0.5:
        mend = "use incompressible = true for 0.5" if nu == 0.5 else ""
        return [Fault("material.poisson_ratio", f"must be above -1 and below 0.5, got {nu}", mend)]
    return []
