"""Cutting laws of materials, and the built-in table of materials."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import files
from postproc.errors import ForceError, choices

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


_LINEAR_KEYS = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2")
_EDGE_KEYS = ("Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
"""Either law may have them."""
_KIENZLE_KEYS = ("kc11_N_per_mm2", "mc", "radial_ratio", "axial_ratio")
_RADIAL_RATIO = 0.3
"""Radial by tangential force of Kienzle's law where it is not stated (assumed)."""


class MaterialTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """`[material]` of process.toml, and one entry of the built-in table; N/mm² and N/mm.

    Either the name of an entry, or Ktc (and the other five), or kc1.1 and mc, or a file of `postproc identify forces`.
    With coefficients, a name that is no entry is a label. What is left out is 0, and `radial_ratio` 0.3.

    :param Kac_N_per_mm2: and Kae_N_per_mm: axial, positive towards the spindle; < 0 if they pull it out.
    :param file: material.toml with a `[material]` of its own, next to the process file.
    :param radial_ratio: with kc1.1: radial by tangential force; axial_ratio: axial by tangential force.
    """

    name: str | None = None
    Ktc_N_per_mm2: Coefficient | None = None
    Krc_N_per_mm2: Coefficient | None = None
    Kac_N_per_mm2: Axial | None = None
    Kte_N_per_mm: Coefficient | None = None
    Kre_N_per_mm: Coefficient | None = None
    Kae_N_per_mm: Axial | None = None
    kc11_N_per_mm2: Coefficient | None = None
    mc: Annotated[float, msgspec.Meta(ge=0, lt=1)] | None = None
    radial_ratio: Annotated[float, msgspec.Meta(ge=0, le=2)] | None = None
    axial_ratio: Annotated[float, msgspec.Meta(ge=0, le=2)] | None = None
    sigma_percent: Annotated[float, msgspec.Meta(ge=0, le=200)] | None = None
    file: str | None = None


class Entry(MaterialTable, frozen=True):
    """An entry of the built-in table, with its title, the source of its values and a warning if they need one."""

    title: str = ""
    source: str = ""
    assumed: bool = False
    warning: str | None = None


class IdentifiedTable(MaterialTable, frozen=True):
    """`[material]` of a material.toml that `postproc identify forces` wrote.

    :param source: origin of the values.
    :param residual_N: RMS of the residuals of the forces.
    :param ci95: half widths of the 95 % intervals by name.
    :param covariance: (6, 6) of Ktc, Krc, Kac [N/mm²], Kte, Kre, Kae [N/mm].
    """

    source: str = ""
    residual_N: float | None = None
    ci95: dict[str, float] = {}
    covariance: list[list[float]] = []


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
    :param sigma: standard deviation of the forces, as a share of them: of published values of the alloy and by wear, or
        as the user states it.
    :param name: name that is shown to the user.
    :param warning: limits of the values, if any.
    :param unknown_axial: standard deviation of the axial force as a share of the force across the axis, where the
        material has no axial coefficients.
    :param covariance: (6, 6) of `cutting` and `edge`; instead of `sigma`, where they were identified.
    """

    cutting: tuple[float, float, float]
    edge: tuple[float, float, float]
    exponent: float
    sigma: float
    name: str
    warning: str | None = None
    unknown_axial: float = 0.0
    covariance: tuple[tuple[float, ...], ...] | None = None

    @property
    def numbers(self) -> tuple[float, ...]:
        """Ktc, Krc, Kac [N/mm²], Kte, Kre, Kae [N/mm], mc, σ [%]; empty if the axial force is unknown."""
        if self.unknown_axial:
            return ()
        cutting, edge = (k / _PER_MM2 for k in self.cutting), (k / _PER_MM for k in self.edge)
        return (*cutting, *edge, self.exponent, 100.0 * self.sigma)

    def chip_factor(self, thickness: Floats) -> Floats:
        """Return the factors h · (h / 1 mm)^(−mc) [m] of the cutting coefficients for chip thicknesses h (…) [m].

        They are 0 for a thickness below 0, which is no chip.
        """
        chip = np.maximum(thickness, 0.0)
        if self.exponent == 0.0:
            return chip
        # at least 1e-9 mm: no division by zero
        return np.asarray(
            chip * np.power(np.maximum(chip * np.float32(_MM), np.float32(1e-9)), -self.exponent), np.float32
        )


_SIGMA_PERCENT = 33.0
"""Default, if neither the user nor the table gives it: the spread of published values for one alloy."""
_WEAR_PERCENT = 25.0
"""Largest growth of the forces as a tool wears. "Tool Wear Factors" of machining power in Machinery's Handbook are 1.10
for end milling and 1.10 to 1.25 for light and medium face milling, as two public extracts of that table quote them; the
book was not looked up. Drilling (1.30) and heavy face milling (1.30 to 1.60) are above it. Anything up to the value is
taken for as likely."""
_WEAR_STATES = 41
"""Number of states of wear over which a probability is averaged (assumed)."""
_SIGMAS_OF_95 = 1.959964
"""95 % of normal numbers of standard deviation 1 are between ± this."""


def _spread_with_wear(sigma: float) -> float:
    """Return the standard deviation of forces by material and wear, as a share of them.

    The force is (1 + e)(1 + w) times the computed one: e is normal with deviation `sigma`, w uniform from 0 to the
    largest growth by wear. Wear only adds, so the error (1 + e)(1 + w) − 1 is not symmetric, and 1.96 times its root
    mean square holds for less than 95 % of tools. The result is the deviation of a symmetric normal error whose 95 %
    interval is as wide as the one that holds for 95 % of tools.

    >>> round(_spread_with_wear(0.33), 3), round(_spread_with_wear(0.0), 3)
    (0.401, 0.12)
    """
    growth = 1.0 + 0.01 * _WEAR_PERCENT * (np.arange(_WEAR_STATES) + 0.5) / _WEAR_STATES  # 1 + w
    # bisection: the half width of the interval that holds for 95 %
    low, high = 0.0, 10.0 * (sigma + 0.01 * _WEAR_PERCENT)
    for _ in range(50):
        half_width = 0.5 * (low + high)
        # |(1 + e)(1 + w) − 1| is below the half width for e between these limits
        lower, upper = (((1.0 + sign * half_width - growth) / growth).tolist() for sign in (-1.0, 1.0))
        probability = np.mean([_interval_probability(*limits, sigma) for limits in zip(lower, upper, strict=True)])
        low, high = (half_width, high) if float(probability) < 0.95 else (low, half_width)
    return high / _SIGMAS_OF_95


def _interval_probability(lower: float, upper: float, sigma: float) -> float:
    """Return the probability that a normally distributed error of deviation `sigma` is from `lower` to `upper`."""
    if sigma <= 0.0:
        return float(lower <= 0.0 <= upper)
    return 0.5 * (math.erf(upper / (math.sqrt(2.0) * sigma)) - math.erf(lower / (math.sqrt(2.0) * sigma)))


_LEAST_TANGENTIAL = 1.0
"""Tangential coefficient [N/mm²] below which no solid is milled: foam has a few N/mm² (assumed)."""
_UNKNOWN_AXIAL_SHARE = 0.7
"""RMS of an unknown axial force as a share of the force across the feed: measured values in slots are 0.4 to 0.9."""


def table() -> dict[str, Entry]:
    """Return the built-in materials: name → entry."""
    return files.read_toml(Path(__file__).with_name("materials.toml"), dict[str, Entry], ForceError)


def six_numbers(material: MaterialTable, file: str) -> tuple[NDArray[np.float64], float] | None:
    """Return Ktc, Krc, Kac [N/mm²], Kte, Kre, Kae [N/mm] of a linear material and their relative standard deviation.

    :returns: array (6,) and deviation; None for a Kienzle material.
    :raises ForceError: the material has no cutting law, see `law`.
    """
    cutting_law = law(material, file)
    if cutting_law.exponent:
        return None
    values = [*(k / _PER_MM2 for k in cutting_law.cutting), *(k / _PER_MM for k in cutting_law.edge)]
    return np.array(values), cutting_law.sigma


def law(material: MaterialTable, file: str) -> CuttingLaw:
    """Return the cutting law of `[material]`.

    :param file: path of the process file, for messages; a material file that it names is relative to its folder.
    :raises ForceError: an unknown name, no coefficients at all, both linear and Kienzle's, or an unusable material
        file.
    """
    covariance = None
    if material.file is not None:
        material, covariance = _material_of_file(material, Path(file).parent / material.file, file)
    entry = _named_entry(material, table(), file)
    tangential, radial, axial = _cutting_coefficients(entry, file)
    tangential_edge, radial_edge, axial_edge = linear_coefficients(entry)[3:]
    has_axial_force = bool(axial or axial_edge)
    return CuttingLaw(
        cutting=(tangential * _PER_MM2, radial * _PER_MM2, axial * _PER_MM2),
        edge=(tangential_edge * _PER_MM, radial_edge * _PER_MM, axial_edge * _PER_MM),
        exponent=entry.mc or 0.0,
        sigma=_sigma_percent(material, entry) / 100.0,
        name=material.name or "given in [material]",
        warning=entry.warning if isinstance(entry, Entry) else _unit_warning(entry),
        unknown_axial=0.0 if has_axial_force else _UNKNOWN_AXIAL_SHARE,  # a standard deviation
        covariance=covariance,
    )


def linear_coefficients(material: MaterialTable) -> tuple[float, ...]:
    """Return Ktc, Krc, Kac [N/mm²], Kte, Kre, Kae [N/mm] of a material; 0 for each that it does not state."""
    return tuple(getattr(material, key) or 0.0 for key in (*_LINEAR_KEYS, *_EDGE_KEYS))


def kienzle_coefficients(material: MaterialTable) -> tuple[float, float, float, float]:
    """Return kc1.1 [N/mm²], mc, and the ratios of the radial and the axial force to the tangential one."""
    radial_ratio = _RADIAL_RATIO if material.radial_ratio is None else material.radial_ratio
    return material.kc11_N_per_mm2 or 0.0, material.mc or 0.0, radial_ratio, material.axial_ratio or 0.0


def _cutting_coefficients(material: MaterialTable, file: str) -> tuple[float, float, float]:
    """Return the tangential, radial and axial cutting coefficient of a material [N/mm²].

    :param material: Ktc, Krc, Kac of the linear law; or kc1.1, the ratios to it, and mc of Kienzle's law.
    :param file: path of the process file, for the message.
    :raises ForceError: the material has neither Ktc nor kc1.1, or keys of both laws; or one of kc1.1 and mc alone.
    """
    linear_keys, kienzle_keys = _stated_keys(material, _LINEAR_KEYS), _stated_keys(material, _KIENZLE_KEYS)
    if linear_keys and kienzle_keys:
        advice = f"Remove {' and '.join(kienzle_keys)}, or {' and '.join(linear_keys)}."
        raise ForceError("[material] has coefficients of two cutting laws", file=file, advice=advice)
    if material.Ktc_N_per_mm2 is not None:
        tangential, radial, axial, *_ = linear_coefficients(material)
        return tangential, radial, axial
    if material.kc11_N_per_mm2 is not None and material.mc is not None:
        kc11, _, radial_ratio, axial_ratio = kienzle_coefficients(material)
        return kc11, kc11 * radial_ratio, kc11 * axial_ratio
    advice = "Give the name of a material, or Ktc_N_per_mm2, Krc_N_per_mm2 … Kae_N_per_mm, or kc11_N_per_mm2 and mc."
    raise ForceError("[material] does not say how it cuts", file=file, advice=advice)


def _stated_keys(material: MaterialTable, keys: Sequence[str]) -> list[str]:
    """Return those of some keys that a material states."""
    return [key for key in keys if getattr(material, key) is not None]


def _named_entry(material: MaterialTable, materials: Mapping[str, MaterialTable], file: str) -> MaterialTable:
    """Return the table with the coefficients: `material` itself if it has any or no name, else the entry of its name.

    :param materials: the built-in materials by name.
    :param file: path of the process file, for the message.
    :raises ForceError: an unknown name, or the name of an entry together with coefficients.
    """
    keys = _stated_keys(material, (*_LINEAR_KEYS, *_EDGE_KEYS, *_KIENZLE_KEYS))
    if material.name is None or (keys and material.name not in materials):
        return material
    if keys:  # one of both would be dropped silently
        problem = f"[material] name = {material.name!r} has coefficients of its own in the table of materials"
        raise ForceError(problem, file=file, advice=f"Remove {' and '.join(keys)}, or call the material otherwise.")
    if material.name not in materials:
        advice = f"{choices(str(material.name), materials)} Or give Ktc_N_per_mm2 … or kc11_N_per_mm2 and mc."
        raise ForceError(f"[material] name: no material {material.name!r}", file=file, advice=advice)
    return materials[material.name]


def _sigma_percent(material: MaterialTable, entry: MaterialTable) -> float:
    """Return the standard deviation of the forces [%].

    :param material: `[material]` of the process: what it states holds as it is.
    :param entry: the table with the coefficients: to what it states, or the default, the spread by wear is added.
    """
    if material.sigma_percent is not None:
        return material.sigma_percent
    percent = _SIGMA_PERCENT if entry.sigma_percent is None else entry.sigma_percent
    return 100.0 * _spread_with_wear(percent / 100.0)


def _material_of_file(
    material: MaterialTable, path: Path, process_file: str
) -> tuple[MaterialTable, tuple[tuple[float, ...], ...] | None]:
    """Return the material of the file that `[material]` names, and its covariance (6, 6), SI.

    The covariance is None if the file states none, or if the process states `sigma_percent` instead.

    :param path: path of the material file.
    :param process_file: path of the process, for messages.
    :raises ForceError: the process has values too, or the file is no material file, or its covariance is invalid.
    """
    if material.name or _stated_keys(material, (*_LINEAR_KEYS, *_EDGE_KEYS, *_KIENZLE_KEYS)):
        raise ForceError("[material] file together with values", file=process_file, advice="Give one of them.")
    content = files.read_toml(path, dict[str, IdentifiedTable], ForceError)
    if set(content) != {"material"} or content["material"].file is not None:
        raise ForceError("this file has no [material] of its own, or more than that", file=str(path))
    file_table = content["material"]
    if material.sigma_percent is None:
        return file_table, _covariance(file_table, str(path))
    return replace(file_table, sigma_percent=material.sigma_percent), None


def _unit_warning(material: MaterialTable) -> str | None:
    """Return a warning for a cutting coefficient that is probably in kN/mm²; None if its size is usual."""
    coefficients = {"Ktc_N_per_mm2": material.Ktc_N_per_mm2, "kc11_N_per_mm2": material.kc11_N_per_mm2}
    for key, value in coefficients.items():
        if value and value < _LEAST_TANGENTIAL:
            return (
                f"[material] {key} = {value:g}: below {_LEAST_TANGENTIAL:g} N/mm² it is that of no solid material that "
                "one mills. Is it in kN/mm²? Give it in N/mm²."
            )
    return None


def _covariance(material: IdentifiedTable, file: str) -> tuple[tuple[float, ...], ...] | None:
    """Return the covariance (6, 6) of identified coefficients, SI; None if the file states none.

    :param file: path of the material file, for the message.
    :raises ForceError: the matrix is not one of six coefficients, not symmetric, or not positive semidefinite.
    """
    if not material.covariance:
        return None
    matrix = np.array(material.covariance) if {len(row) for row in material.covariance} == {6} else np.zeros((0, 0))
    is_symmetric = matrix.shape == (6, 6) and np.allclose(matrix, matrix.T, rtol=1e-4)
    # a covariance has no negative eigenvalues, but for the rounding of numbers in the file
    if not is_symmetric or np.linalg.eigvalsh(matrix / max(float(np.trace(matrix)), 1e-12))[0] < -1e-4:
        advice = "Take the file as `identify forces` wrote it, or delete the key: sigma_percent is used then."
        raise ForceError("[material] covariance is no covariance of six coefficients", file=file, advice=advice)
    factor = np.repeat([_PER_MM2, _PER_MM], 3)  # from N/mm² and N/mm
    return tuple(tuple(row) for row in (matrix * np.outer(factor, factor)).tolist())
