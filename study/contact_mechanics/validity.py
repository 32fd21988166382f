"""How deep the closed form holds: each assumption ends at a depth, and the least one counts.

The limits are depths at which the built-in finite elements (neo-Hookean, nu = 0.4999, no
friction) resist about 3 % less than the closed form; docs/analytic_indentation.py makes the runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.contact_mechanics.force_law import WIDEST, ForceLaw
from study.contact_mechanics.layer import Layer
from study.setup.geometry import Cone, Flat, Indenter, Sphere

#: depth over the radius of a sphere: strains under it are about 0.2 a/R (Tabor 1951)
SPHERE_DEPTH = 0.1

#: depth over the radius of a flat punch
PUNCH_DEPTH = 0.15

#: depth over the height of the layer: the mean strain under a wide contact
LAYER_DEPTH = 0.1

#: chi = sqrt(R d) / h up to which the published series was compared with experiments
SERIES_CHI = 1.0

#: shortening of the whole specimen, as a free column, over the depth: its sides are no layer's
COLUMN_SHARE = 0.03

#: depths at which a limit that rises with depth is looked for
_DEPTHS = 400


@dataclass(frozen=True)
class Limit:
    """Depth at which one assumption ends.

    Parameters
    ----------
    what : str
        The assumption, with its bound.
    depth_mm : float
        Largest depth at which it holds; infinite where it always does.
    """

    what: str
    depth_mm: float

    def to_json(self) -> dict[str, object]:
        """Plain values; null for a limit that is never met."""
        reached = bool(np.isfinite(self.depth_mm))
        return {"limit": self.what, "depth_mm": self.depth_mm if reached else None}


def limits(
    indenter: Indenter,
    layer: Layer,
    law: ForceLaw,
    *,
    area_mm2: float | None = None,
    is_series: bool = False,
) -> tuple[Limit, ...]:
    """Depths at which the assumptions of the closed form end, the least first.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in.
    layer : Layer
        What is indented.
    law : ForceLaw
        Force by depth; it must reach as deep as the data do.
    area_mm2 : float, optional
        Cross-section of the specimen; a layer without sides if left out.
    is_series : bool
        Whether the published series for thin layers is used.
    """
    found = [Limit(f"d/h <= {LAYER_DEPTH:g}", LAYER_DEPTH * layer.height_mm)]
    if isinstance(indenter, Sphere):
        found.append(Limit(f"d/R <= {SPHERE_DEPTH:g}", SPHERE_DEPTH * indenter.radius_mm))
    if isinstance(indenter, Flat):
        found.append(Limit(f"d/a <= {PUNCH_DEPTH:g}", PUNCH_DEPTH * indenter.radius_mm))
    if isinstance(indenter, Cone) and indenter.shaft_radius_mm is not None:
        found.append(Limit("a below the shaft", _depth_at(law, indenter.shaft_radius_mm)))
    if is_series and isinstance(indenter, Sphere):
        depth = (SERIES_CHI * layer.height_mm) ** 2 / indenter.radius_mm
        found.append(Limit(f"sqrt(R d)/h <= {SERIES_CHI:g}", depth))
    else:
        found.append(Limit(f"a/h <= {WIDEST:g}", _depth_at(law, WIDEST * layer.height_mm)))
    if area_mm2 is not None:
        found.append(_column(layer, law, area_mm2))
    return tuple(sorted(found, key=lambda one: one.depth_mm))


def _depth_at(law: ForceLaw, radius_mm: float) -> float:
    """Depth at which contact reaches a radius; infinite beyond the table, 0 before it."""
    if radius_mm <= law.radius_mm[0]:
        return 0.0
    if radius_mm > law.radius_mm[-1]:
        return float("inf")
    log = np.interp(np.log(radius_mm), np.log(law.radius_mm), np.log(law.depth_mm))
    return float(np.exp(log))


def _column(layer: Layer, law: ForceLaw, area_mm2: float) -> Limit:
    """Depth up to which a narrow specimen yields as a whole by little."""
    depths = law.depth_mm[-1] * np.logspace(-4, 0, _DEPTHS)
    per_modulus = law.force(depths) / (1 - layer.poisson_ratio**2)
    share = per_modulus * layer.height_mm / (area_mm2 * depths)
    above = np.flatnonzero(share > COLUMN_SHARE)
    depth = float("inf") if not above.size else float(depths[above[0] - 1]) if above[0] else 0.0
    return Limit(f"shortening of the whole specimen <= {100 * COLUMN_SHARE:g} % of d", depth)


def caution(indenter: Indenter) -> str:
    """Say what no depth mends; empty where nothing is wrong.

    Parameters
    ----------
    indenter : Flat, Cone or Sphere
        What is pressed in; a cone of less than 75 deg, measured from its axis, gets a caution.
    """
    if isinstance(indenter, Cone) and indenter.half_angle_deg < 75:
        return (
            f"a cone of {indenter.half_angle_deg:g} deg strains by the same amount at any depth: a "
            "neo-Hookean solid resists 10 % less than the closed form at 30 deg, 7 % at 45 deg, "
            "5 % at 60 deg, and the modulus is as much too low"
        )
    return ""
