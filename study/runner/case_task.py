"""A case as it goes to a worker: what is known of its record, its problem, its fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

from study.curve import Curve
from study.execution.task import Received
from study.forward.finite_element import Anchor
from study.record.record import Record
from study.runner.fitting.fit_summary import FitResult
from study.runner.provenance import versions
from study.runner.response import Scored
from study.setup.material_section import MaterialSection
from study.setup.setup import Tables

#: role of a direction that gives the constants of a specimen where its score is held out
CONSTANTS = "constants"

#: Where the predicted curve of a case comes from: the last solution of its fit, a closed form,
#: a solution of its own, or one by another program.
Forward = Literal["fit", "closed-form", "simulation", "external"]


@dataclass(frozen=True)
class Origin:
    """Why a case is computed besides the cells of the design; its record says so.

    Parameters
    ----------
    mesh_seed, noise_seed : int, optional
        Number among the cases that repeat a cell on other meshes, or with resampled residuals.
    purpose : {"refinement", "input"}, optional
        What it serves beside the study's own answer.
    of : str, optional
        Id of the case that it is compared with.
    level : int, optional
        How often the mesh was refined.
    input : str, optional
        Key of the input that was moved.
    """

    mesh_seed: int | None = None
    noise_seed: int | None = None
    purpose: Literal["refinement", "input"] | None = None
    of: str | None = None
    level: int | None = None
    input: str | None = None

    @property
    def predicts(self) -> bool:
        """Whether its curve is wanted: a fit to resampled residuals has constants alone."""
        return not self.noise_seed

    def to_json(self) -> dict[str, object]:
        """Plain data without what does not apply."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class CaseFrame:
    """Everything of a record that is known before the case is computed.

    Parameters
    ----------
    case_id, study, input_hash : str
        As in the record.
    levels : mapping of str to str
        Level of every factor.
    block : str or None
        Label of the block.
    units : mapping of str to str
        Unit of every response that the record holds.
    origin : Origin
        Why it is computed besides the cells of the design.
    """

    case_id: str
    study: str
    levels: Mapping[str, str]
    block: str | None
    units: Mapping[str, str]
    input_hash: str
    origin: Origin

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: Received) -> CaseFrame:
        """Inverse of :meth:`to_json`."""
        return cls(**{**document, "origin": Origin(**document["origin"])})

    def record(
        self,
        status: str,
        message: str,
        *,
        seconds: float | None = None,
        traceback: str = "",
    ) -> Record:
        """Record of a case without an answer: every response is missing."""
        return Record(
            case_id=self.case_id,
            study=self.study,
            levels=self.levels,
            block=self.block,
            status=status,
            message=message,
            responses={name: {"value": None, "unit": unit} for name, unit in self.units.items()},
            timings={} if seconds is None else {"total": seconds},
            versions=versions(),
            input_hash=self.input_hash,
            extra=self.origin.to_json() | ({"traceback": traceback} if traceback else {}),
        )


@dataclass(frozen=True)
class ScoreTask:
    """One direction of a case: the scored curve, and the fit that gives the constants.

    Parameters
    ----------
    label, role, fit_label, measured, scatter_N
        As of :class:`study.runner.job.ScorePair`.
    depth_mm : float
        How far the curve is predicted.
    fit_key : str or None
        Name of the fit.
    fit : FitResult or None
        What it found; None where the constants are given.
    """

    label: str
    measured: Curve | None
    role: str
    fit_label: str
    scatter_N: tuple[float, ...] | None  # noqa: N815
    depth_mm: float
    fit_key: str | None
    fit: FitResult | None

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {
            **vars(self),
            "measured": None if self.measured is None else self.measured.as_dict(),
            "fit": None if self.fit is None else self.fit.to_json(),
        }

    @classmethod
    def from_json(cls, document: Received) -> ScoreTask:
        """Inverse of :meth:`to_json`."""
        fit, measured = document["fit"], document["measured"]
        scatter = document["scatter_N"]
        return cls(**{
            **document,
            "measured": None if measured is None else Curve.from_dict(measured),
            "scatter_N": None if scatter is None else tuple(scatter),
            "fit": None if fit is None else FitResult.from_json(fit),
        })  # fmt: skip

    def scored(self, tables: Tables, predicted: Curve | None = None) -> Scored:
        """Collect what responses are computed from; given constants stand in the tables."""
        if self.fit is not None:
            return Scored(self.measured, predicted, self.fit.constants, self.fit.fit.get("mu0"))
        material = MaterialSection.of(tables).material()
        return Scored(self.measured, predicted, material.constants, material.mu0)


@dataclass(frozen=True)
class CaseTask:
    """A case as it goes to a worker, complete in itself.

    Parameters
    ----------
    frame : CaseFrame
        What is known of its record.
    tables : mapping
        The problem that predicts.
    forward : str
        Where the predicted curves come from.
    directions : tuple of ScoreTask
        What is scored.
    anchor : Anchor or None
        The solution that the cases of a cell start from.
    """

    frame: CaseFrame
    tables: Tables
    forward: Forward
    directions: tuple[ScoreTask, ...]
    anchor: Anchor | None = None

    @property
    def scored(self) -> tuple[ScoreTask, ...]:
        """Directions whose curves are predicted and scored."""
        return tuple(one for one in self.directions if one.role != CONSTANTS)

    @property
    def identified(self) -> tuple[ScoreTask, ...]:
        """Directions that give the constants: the specimen's own where its score is held out."""
        return tuple(one for one in self.directions if one.role == CONSTANTS) or self.directions

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {
            "kind": "case",
            "frame": self.frame.to_json(),
            "tables": dict(self.tables),
            "forward": self.forward,
            "directions": [one.to_json() for one in self.directions],
            "anchor": None if self.anchor is None else asdict(self.anchor),
        }

    @classmethod
    def from_json(cls, document: Received) -> CaseTask:
        """Inverse of :meth:`to_json`."""
        anchor = document["anchor"]
        return cls(
            CaseFrame.from_json(document["frame"]),
            document["tables"],
            document["forward"],
            tuple(ScoreTask.from_json(one) for one in document["directions"]),
            None if anchor is None else Anchor(**anchor),
        )
