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
    ("--overwrite",),
    "overwrite",
    "flag",
    "Replace files that postproc did not write, or not as they are.",
    label="Replace files that were edited",
)
DIALECT = Option(
    ("--dialect",),
    "dialect",
    "dialect",
    "Format of the input: apt, gcode, krl or rapid; default: by the extension.",
    "NAME",
)
SHARED_OPTIONS = (
    Option(("--cell",), "cell", "path", "Cell file: robot, base, tool, tolerances.", required=True),
    Option(
        ("--process",),
        "process",
        "path",
        "Material, tools and stock, from which the forces are computed: process.toml.",
    ),
    Option(
        ("--forces",),
        "forces",
        "path",
        "File of cutting forces (CSV, or what a package adds), or a folder with NAME.csv … for each program.",
    ),
    Option(("--part",), "part", "path", "Mesh of the part (STL …, mm, $BASE): shows what its surface will be."),
    Option(
        ("--part-tolerance",),
        "part_tolerance_mm",
        "length",
        "What the part may be off (95 %), by which the verdict judges; replaces tolerance_mm of [part].",
        "MM",
        label="Tolerance of the part, mm",
    ),
    Option(
        ("--keep-unresolved",),
        "keep_unresolved",
        "flag",
        "Leave KRL motions unchanged whose targets, or whether they run, are only known at run time.",
        label="Leave unresolved KRL motions unchanged",
    ),
    Option(
        ("-o", "--output"), "output", "path", "Folder to write into; default: corrected/ in the folder of the program."
    ),
    DIALECT,
    Option(("--json",), "as_json", "flag", "Print the summary as JSON."),
    OVERWRITE,
)
"""Options of `convert`, `watch` and `predict`, in the order of `--help`."""
CONVERSION = (
    *SHARED_OPTIONS,
    Option(
        ("--tolerance",),
        "tolerance_mm",
        "length",
        "What the predicted path may leave the nominal one by; replaces tolerance_mm of the cell.",
        "MM",
        minimum=1e-4,
        label="Tolerance of the path, mm",
    ),
    Option(
        ("--lines-per-file",),
        "lines_per_file",
        "count",
        "Divide KRL of more lines, 0: never; replaces lines_per_file of the cell.",
        "N",
        minimum=0,
        label="Lines per file",
    ),
    Option(
        ("--to",),
        "to",
        "dialect",
        "Language to write G-code in: krl (default) or rapid.",
        "NAME",
    ),
    Option(("--linearize-arcs",), "linearize_arcs", "flag", "Write arcs as lines.", label="Write arcs as lines"),
)
"""Options of `convert` and `watch`."""
