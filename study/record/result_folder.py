"""Results that are no records: fits that cases share, solutions of refinement series."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from study.curve import Curve
from study.record.document import CurveKey, SolutionDocument, StoredFitDocument
from study.record.document_checks import fault_of_curves, fault_of_fits
from study.record.libraries import name_of
from study.record.manifests import ManifestFolder
from study.record.record import CONVERGED

#: key of a stored result: name of the libraries that made it
_MADE_WITH = "made_with"

#: ends of a fit that has constants
ENDS_WITH_CONSTANTS = (CONVERGED, "at-edge", "at-kink")


class ResultFolder(ManifestFolder):
    """Results folder in which each result keeps the name of the libraries that made it."""

    #: name of the libraries that make what is written now, and whether nothing else counts
    _libraries = ""
    _strict = False

    def made_with(self, versions: Mapping[str, str], *, strict: bool = False) -> None:
        """Say which libraries compute from now on.

        Parameters
        ----------
        versions : mapping of str to str
            Version of each.
        strict : bool
            Whether results that were made with others are as missing.
        """
        self._libraries, self._strict = name_of(versions), strict

    def write_fit(
        self, fit_id: str, content: Mapping[str, object], *, followed: bool = False
    ) -> None:
        """Store a calibration that several cases share; ``followed`` as for a record."""
        self._write_result(f"fits/{fit_id}", content, followed)

    def read_fit(self, fit_id: str) -> dict[str, object] | None:
        """Read a shared calibration; None if it is missing, was damaged, or does not count."""
        found = self.read_document(f"fits/{fit_id}", StoredFitDocument, _fault_of_fit)
        return self._counting(found)

    def write_solution(self, key: str, content: Mapping[str, object]) -> None:
        """Store a solution of a refinement series."""
        self._write_result(f"solves/{key}", content, False)

    def read_solution(self, key: str) -> dict[str, object] | None:
        """Read a solution; None as for a calibration."""
        found = self.read_document(f"solves/{key}", SolutionDocument, _fault_of_solution)
        return self._counting(found)

    def _write_result(self, name: str, content: Mapping[str, object], followed: bool) -> None:
        self.write_json(name, {**content, _MADE_WITH: self._libraries}, followed=followed)

    def _counting(
        self, found: StoredFitDocument | SolutionDocument | None
    ) -> dict[str, object] | None:
        """Leave out the name of the libraries; None where other ones are to be as missing."""
        if found is None:
            return None
        result = cast("dict[str, object]", found)
        made_with = result.pop(_MADE_WITH, "")
        return None if self._strict and made_with != self._libraries else result


def _fault_of_fit(fit: StoredFitDocument) -> str:
    """Say why cases cannot use a fit that they share; empty if they can."""
    if fit["status"] in ENDS_WITH_CONSTANTS and not fit.get("values"):
        return "it has no values"
    if set(fit.get("names", ())) != fit.get("values", {}).keys():
        return "its names are not those of its values"
    if "curve" not in fit:
        return fault_of_fits({"fit": fit}, needed=())
    if "solver" not in fit:
        return "it has no solver"
    return fault_of_fits({"fit": fit}, needed=()) or _fault_of_curve(fit["curve"])


def _fault_of_solution(found: SolutionDocument) -> str:
    """Say why a series cannot use a solution; empty if it can."""
    if found["status"] != CONVERGED:
        return _fault_of_curve(found["curve"]) if found.get("curve") else ""
    lost = [key for key in ("curve", "elements", "dofs") if key not in found]
    return f"it has no {lost[0]}" if lost else _fault_of_curve(found["curve"])


def _fault_of_curve(written: Mapping[str, object]) -> str:
    try:
        curve = Curve.from_dict(written)
    except (TypeError, ValueError, LookupError, ArithmeticError) as error:
        return f"its curve cannot be read ({error})"
    return fault_of_curves({CurveKey("predicted", "force"): curve})
