"""Options that commands share: one table for `--help` and the reference.

`cli.options` makes click options of it. It imports nothing, so that `--help` stays quick.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Kind = Literal["flag", "path", "length", "count", "dialect"]
"""What an option takes: nothing, a file or folder, a length in mm, a whole number, or the name of a language."""


class Option(NamedTuple):
    """An option of an action.

    :param flags: as typed, such as ``("-o", "--output")``; the last one is the long one.
    :param name: of the value in `Settings` or `find_jobs`.
    :param help: a sentence: what it does, its unit, its default.
    :param metavar: what `--help` shows as the value; empty: what the kind shows.
    :param minimum: smallest value; None: no bound but that of the kind.
    :param label: a few words for a form; empty: not in a form.
    """

    flags: tuple[str, ...]
    name: str
    kind: Kind
    help: str
    metavar: str = ""
    required: bool = False
    minimum: float | None = None
    label: str = ""


OVERWRITE = Option(
    flags=("--overwrite",),
    name="overwrite",
    kind="flag",
    help="Replace files that postproc did not write, or not as they are.",
    label="Replace files that were edited",
)
DIALECT = Option(
    flags=("--dialect",),
    name="dialect",
    kind="dialect",
    help="Format of the input: apt, gcode, krl or rapid; default: by the extension.",
    metavar="NAME",
)
SHARED_OPTIONS = (
    Option(
        flags=("--cell",), name="cell", kind="path", help="Cell file: robot, base, tool, tolerances.", required=True
    ),
    Option(
        flags=("--process",),
        name="process",
        kind="path",
        help="Material, tools and stock, from which the forces are computed: process.toml.",
    ),
    Option(
        flags=("--forces",),
        name="forces",
        kind="path",
        help="File of cutting forces (CSV, or what a package adds), or a folder with NAME.csv … for each program.",
    ),
    Option(
        flags=("--part",),
        name="part",
        kind="path",
        help="Mesh of the part (STL …, mm, $BASE): shows what its surface will be.",
    ),
    Option(
        flags=("--part-tolerance",),
        name="part_tolerance_mm",
        kind="length",
        help="What the part may be off (95 %), by which the verdict judges; replaces tolerance_mm of [part].",
        metavar="MM",
        label="Tolerance of the part, mm",
    ),
    Option(
        flags=("--keep-unresolved",),
        name="keep_unresolved",
        kind="flag",
        help="Leave KRL motions unchanged whose targets, or whether they run, are only known at run time.",
        label="Leave unresolved KRL motions unchanged",
    ),
    Option(
        flags=("-o", "--output"),
        name="output",
        kind="path",
        help="Folder to write into; default: corrected/ in the folder of the program.",
    ),
    DIALECT,
    Option(flags=("--json",), name="as_json", kind="flag", help="Print the summary as JSON."),
    OVERWRITE,
)
"""Options of `convert`, `watch` and `predict`, in the order of `--help`."""
CONVERSION = (
    *SHARED_OPTIONS,
    Option(
        flags=("--tolerance",),
        name="tolerance_mm",
        kind="length",
        help="What the predicted path may leave the nominal one by; replaces tolerance_mm of the cell.",
        metavar="MM",
        minimum=1e-4,
        label="Tolerance of the path, mm",
    ),
    Option(
        flags=("--lines-per-file",),
        name="lines_per_file",
        kind="count",
        help="Divide KRL of more lines, 0: never; replaces lines_per_file of the cell.",
        metavar="N",
        minimum=0,
        label="Lines per file",
    ),
    Option(
        flags=("--to",),
        name="to",
        kind="dialect",
        help="Language to write G-code in: krl (default) or rapid.",
        metavar="NAME",
    ),
    Option(
        flags=("--linearize-arcs",),
        name="linearize_arcs",
        kind="flag",
        help="Write arcs as lines.",
        label="Write arcs as lines",
    ),
)
"""Options of `convert` and `watch`."""
