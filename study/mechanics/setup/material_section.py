"""Section ``[material]``: an energy, its constants as far as given, compressibility, relaxation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import cast

from study.ground.declaration import field_named, section_of
from study.ground.errors import Fault, InputError
from study.mechanics.material.energy import FREE, Bounds, Compressibility, DeclaredConstants
from study.mechanics.material.material import Material, constant_names, energy_named
from study.mechanics.material.relaxation import RelaxationTerm, relaxation_names

#: of the stress that may fade, as a fit starts; the rest stays
_FADING = 0.5
#: all of the stress may fade, none may grow
_SHARES: Bounds = (0.0, 1.0)


@dataclass(frozen=True)
class RelaxationKey:
    """One term of a relaxation as a file gives it."""

    #: Of the instantaneous stress; None where a calibration finds it.
    share: float | None
    #: After which it has faded to 1/e, s; where a fit of it starts.
    time_s: float
    #: Within which a calibration finds the time; None where it is as given.
    range_s: tuple[float, float] | None = None

    def document(self) -> dict[str, object]:
        """Plain values."""
        fitted = {} if self.range_s is None else {"range_s": list(self.range_s)}
        return {"share": self.share, "time_s": self.time_s, **fitted}

    @classmethod
    def of(cls, document: Mapping[str, object]) -> RelaxationKey:
        """Inverse of :meth:`document`."""
        ends = document.get("range_s")
        return cls(**{**document, "range_s": ends and tuple(ends)})  # type: ignore[arg-type]


@dataclass(frozen=True)
class MaterialSection:
    """A material whose constants may have to be calibrated."""

    model: str
    #: Number of terms; None for an energy that has no choice.
    order: int | None
    #: In MPa, exponents plain; empty where a calibration finds them.
    constants: Mapping[str, float]
    compressibility: Compressibility
    #: How its stress fades; empty where it does not.
    relaxation: tuple[RelaxationKey, ...] = ()

    @classmethod
    def of(cls, table: Mapping[str, object]) -> MaterialSection:
        """Material of its resolved table, in MPa and s."""
        resistance = section_of("material", Compressibility, table)
        order = cast("int | None", table.get("order"))
        constants = cast("Mapping[str, float]", table.get("constants") or {})
        terms = cast("list[Mapping[str, object]]", table.get("relaxation") or [])
        fading = tuple(RelaxationKey.of(term) for term in terms)
        return cls(str(table.get("model", "")), order, constants, resistance, fading)

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a calibration of this material finds."""
        names = tuple(self.constants or constant_names(self.model, self.order))
        return (*names, *self.starts_of_relaxation())

    def value_at(self, key: str) -> float | None:
        """Return a constant, or the number that says how volume changes; None without one."""
        name = field_named(self.compressibility, key)
        if name is None:
            return self.constants.get(key)
        value: float | None = getattr(self.compressibility, name)
        return None if isinstance(value, bool) else value

    def with_value(self, key: str, value: float) -> MaterialSection:
        """Copy with another value of a number that it has."""
        name = field_named(self.compressibility, key)
        if name is None:
            return replace(self, constants={**self.constants, key: value})
        return replace(self, compressibility=replace(self.compressibility, **{name: value}))  # type: ignore[arg-type]

    def starts_of_relaxation(self) -> dict[str, float]:
        """Shares, and times that are to be found, where a fit of them starts."""
        starts = {}
        for k, term in enumerate(self.relaxation, 1):
            usual = _FADING / len(self.relaxation)
            starts[f"share{k}"] = usual if term.share is None else term.share
            if term.range_s is not None:
                starts[f"time{k}"] = term.time_s
        return starts

    def bounds(self, name: str) -> Bounds:
        """Range in which a constant is looked for where the file gives none."""
        for k, term in enumerate(self.relaxation, 1):
            if name == f"share{k}":
                return _SHARES
            if name == f"time{k}" and term.range_s is not None:
                return term.range_s
        energy = energy_named(self.model)
        return energy.bounds(name) if isinstance(energy, DeclaredConstants) else FREE

    def material(self, constants: Mapping[str, float] | None = None) -> Material:
        """Material with numbers. Units: constants MPa, s."""
        given = self.constants if constants is None else constants
        values = {n: v for n, v in given.items() if n not in relaxation_names(self.relaxation)}
        if not values:
            mend = "give them or calibrate"
            raise InputError(Fault("material", "the constants are not known yet", mend))
        volume = self.compressibility
        return Material(
            model=self.model,
            constants=values,
            bulk_modulus=volume.bulk_modulus_MPa,
            poisson_ratio=volume.poisson_ratio,
            incompressible=volume.incompressible,
            relaxation=tuple(self._terms(given)),
        )

    def _terms(self, given: Mapping[str, float]) -> Iterator[RelaxationTerm]:
        for k, term in enumerate(self.relaxation, 1):
            share = given.get(f"share{k}", term.share)
            if share is None:
                rule = f"the share of term {k} is not known yet"
                raise InputError(Fault("material.relaxation", rule, "give it or calibrate"))
            if term.range_s is not None and f"time{k}" not in given:
                rule = f"the time of term {k} is a range, of which a calibration finds one"
                raise InputError(Fault("material.relaxation", rule, "give one time or calibrate"))
            yield RelaxationTerm(float(share), float(given.get(f"time{k}", term.time_s)))
