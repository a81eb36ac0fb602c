"""What a material does to a cutting edge, and the table of materials that comes along."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from postproc import files
from postproc.errors import ForceError

Floats = NDArray[np.float32]

_PER_MM2 = 1e6
"""N/m² of one N/mm²."""
_PER_MM = 1e3
"""N/m of one N/mm."""
_MM = 1e3
"""Millimetres of one metre: the chip thickness of Kienzle's equation is in mm."""

Coefficient = Annotated[float, msgspec.Meta(ge=0, le=1e5)]
Axial = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
"""Positive towards the spindle."""


class MaterialTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """`[material]` of process.toml, and one entry of the table that comes along; N/mm² and N/mm.

    Either the name of an entry, or Ktc (and the other five), or kc1.1 and mc.

    :param Kac_N_per_mm2: and Kae_N_per_mm: axial, positive towards the spindle; < 0 for a tool that is drawn out of it.
    :param radial_ratio: with kc1.1: radial by tangential force; axial_ratio: axial by tangential force.
    """

    name: str | None = None
    Ktc_N_per_mm2: Coefficient | None = None
    Krc_N_per_mm2: Coefficient = 0.0
    Kac_N_per_mm2: Axial = 0.0
    Kte_N_per_mm: Coefficient = 0.0
    Kre_N_per_mm: Coefficient = 0.0
    Kae_N_per_mm: Axial = 0.0
    kc11_N_per_mm2: Coefficient | None = None
    mc: Annotated[float, msgspec.Meta(ge=0, lt=1)] | None = None
    radial_ratio: Annotated[float, msgspec.Meta(ge=0, le=2)] = 0.3
    axial_ratio: Annotated[float, msgspec.Meta(ge=0, le=2)] = 0.0
    sigma_percent: Annotated[float, msgspec.Meta(ge=0, le=200)] | None = None


class Entry(MaterialTable, frozen=True):
    """An entry of the table that comes along: what it is, where its values come from, what to beware of."""

    title: str = ""
    source: str = ""
    assumed: bool = False
    warning: str | None = None


class CuttingLaw(msgspec.Struct, frozen=True):
    """Force of a material on a cutting edge, SI.

    On a piece of edge of length b under chip thickness h the forces are tangential, radial (normal to the edge and to
    the cut) and axial (along the edge's own normal plane):

        F = cutting · h · (h / 1 mm)^(−exponent) · b + edge · b

    With exponent 0 that is the linear edge-force model (Altintas, "Manufacturing Automation", 2nd ed., 2012, ch. 2);
    without `edge` it is Kienzle's (Kienzle and Victor 1957): kc = kc1.1 · h^(−mc).

    :param cutting: Ktc, Krc, Kac [N/m²].
    :param edge: Kte, Kre, Kae [N/m].
    :param exponent: mc; 0 in the linear model.
    :param sigma: standard deviation of the forces, as a share of them.
    :param name: as told to the user.
    :param warning: what to beware of, if anything.
    """

    cutting: tuple[float, float, float]
    edge: tuple[float, float, float]
    exponent: float
    sigma: float
    name: str
    warning: str | None = None

    def chip(self, thickness: Floats) -> Floats:
        """Return what the cutting coefficients are multiplied by [m], for chips of a thickness [m], 0 for none."""
        cut = np.maximum(thickness, 0.0)
        if self.exponent == 0.0:
            return cut
        return np.asarray(
            cut * np.power(np.maximum(cut * np.float32(_MM), np.float32(1e-9)), -self.exponent), np.float32
        )


_SIGMA_PERCENT = 15.0
"""Where neither the user nor the table says it."""


def table() -> dict[str, Entry]:
    """Return the materials that come along: name → entry."""
    return files.read_toml(Path(__file__).with_name("materials.toml"), dict[str, Entry], ForceError)


def law(given: MaterialTable, file: str) -> CuttingLaw:
    """Return the cutting law of `[material]`.

    :raises ForceError: an unknown name, no coefficients at all, or both kinds of them.
    """
    known = table()
    entry: MaterialTable = given
    named = given.name is not None and given.Ktc_N_per_mm2 is None and given.kc11_N_per_mm2 is None
    if named:
        if given.name not in known:
            advice = f"Known: {', '.join(known)}; or give Ktc_N_per_mm2 … or kc11_N_per_mm2 and mc."
            raise ForceError(f"[material] name: no material {given.name!r}", file=file, advice=advice)
        entry = known[given.name]
    linear, kienzle = entry.Ktc_N_per_mm2, entry.kc11_N_per_mm2
    if (linear is None) == (kienzle is None) or (kienzle is None) != (entry.mc is None):
        advice = (
            "Give the name of a material, or Ktc_N_per_mm2, Krc_N_per_mm2 … Kae_N_per_mm, or kc11_N_per_mm2 and mc."
        )
        raise ForceError("[material] does not say how it cuts", file=file, advice=advice)
    percent = given.sigma_percent if given.sigma_percent is not None else entry.sigma_percent
    sigma = (_SIGMA_PERCENT if percent is None else percent) / 100.0
    if linear is not None:
        cutting = (linear, entry.Krc_N_per_mm2, entry.Kac_N_per_mm2)
    else:
        cutting = (
            float(kienzle or 0.0),
            float(kienzle or 0.0) * entry.radial_ratio,
            float(kienzle or 0.0) * entry.axial_ratio,
        )
    edge = (entry.Kte_N_per_mm, entry.Kre_N_per_mm, entry.Kae_N_per_mm)
    return CuttingLaw(
        cutting=(cutting[0] * _PER_MM2, cutting[1] * _PER_MM2, cutting[2] * _PER_MM2),
        edge=(edge[0] * _PER_MM, edge[1] * _PER_MM, edge[2] * _PER_MM),
        exponent=entry.mc or 0.0,
        sigma=sigma,
        name=given.name or "given in [material]",
        warning=entry.warning if isinstance(entry, Entry) else None,
    )
