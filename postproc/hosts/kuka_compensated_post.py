"""FreeCAD post: KUKA KRL, corrected for the deflection of the robot under cutting forces, by way of `postproc`.

Put where FreeCAD looks for posts by ``postproc install-post freecad``. Legacy interface ``export(objects, filename,
arguments)``, which every FreeCAD from 0.20 on calls. The commands of the job's operations are written as G-code of
LinuxCNC, with seven digits, and handed to ``postproc convert``; nothing is computed here.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shlex
import struct
import sys
from pathlib import Path
from typing import Any, NoReturn

sys.path.insert(0, str(Path(__file__).resolve().parent))
from postproc_host import Block, HostError, convert
from postproc_host.safe_text import one_line

del sys.path[0]

TOOLTIP = """
KUKA KRL whose path stays true under cutting forces: postproc predicts the deflection of the robot at each pose and
corrects the targets. Writes NAME.src, NAME.report.html, NAME.targets.csv and NAME.report.json, all or none.
Needs a cell file (robot, base, tool): --cell CELL.toml. Forces: --material NAME, computed from stock, tools, speeds
and feeds of the job (NAME.process.toml says what was taken); or --process FILE.toml; or comments such as
(FORCE FX=120 FY=-40 FZ=300) in Custom operations; or --forces FILE.csv by line of NAME.moves.txt.
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are messages for the user of FreeCAD; argparse itself would end FreeCAD."""

    def error(self, message: str) -> NoReturn:
        """Refuse arguments of the post, instead of ending the program.

        :raises HostError: always, with the arguments that are understood.
        """
        raise HostError(f"Arguments of the post: {message}. Understood are:\n{self.format_help()}")


_parser = _Parser(prog="kuka_compensated", add_help=False)
_parser.add_argument("--cell", required=True, metavar="CELL.toml", help="cell file: robot, base, tool, tolerances")
_parser.add_argument("--forces", metavar="FILE.csv", default="", help="cutting forces by line of NAME.moves.txt")
_parser.add_argument(
    "--material", metavar="NAME", default="", help="forces from stock and tools of the job: postproc forces --materials"
)
_parser.add_argument(
    "--process", metavar="FILE.toml", default="", help="forces from material, tools and stock of a file"
)
_parser.add_argument("--out-dir", metavar="FOLDER", default="", help="where to write; default: where FreeCAD writes")
_parser.add_argument("--name", default="", help="of the program; default: that of FreeCAD's output file")
_parser.add_argument("--nominal", action="store_true", help="write the path as it is, to compare against")
_parser.add_argument("--tolerance", metavar="MM", default="", help="what the path may leave the nominal one by")
_parser.add_argument("--no-show-editor", action="store_true", help="no effect; understood as in other posts")
TOOLTIP_ARGS = _parser.format_help()

UNITS = "G21"
MACHINE_NAME = "KUKA robot"

_WORDS = "XYZABCUVWIJKRQPLFSTHD"
_names: list[str] = []
"""Of the programs that were asked for without a file name. FreeCAD from 1.0 on loads the post anew for each run, and
asks for the sections of a job that splits its output one by one.
"""


def export(objectslist: list[Any], filename: str, argstring: str) -> str:
    """Return corrected KRL of the objects of a job, and write it with its report.

    :param objectslist: what FreeCAD posts: fixtures, tool controllers, operations.
    :param filename: file that FreeCAD chose, or "-" if FreeCAD itself writes the text.
    :param argstring: the job's arguments, see `TOOLTIP_ARGS`.
    :raises HostError: nothing can be written, or the program does not fit into one text; the message is shown, too.
    """
    import FreeCAD

    try:
        return _post(FreeCAD, objectslist, filename, argstring)
    except HostError as cause:
        _show(FreeCAD, str(cause))
        raise


def _post(FreeCAD: Any, objects: list[Any], filename: str, argstring: str) -> str:
    """Convert the objects; return the text of the program and print verdict and warnings.

    :raises HostError: arguments exclude each other, or the program does not fit into one text.
    """
    options = _parsed_arguments(argstring)
    blocks = _blocks(objects)
    document = FreeCAD.ActiveDocument
    folder, name = _folder_and_name(options, filename, document, objects)
    flags = [("--cell", _absolute_path(options.cell, document)), ("--lines-per-file", "0")]  # FreeCAD takes one text
    if sum(bool(source) for source in (options.forces, options.process, options.material)) > 1:
        raise HostError("Arguments of the post: --forces, --process and --material exclude each other.")
    flags += [("--forces", _absolute_path(options.forces, document))] if options.forces else []
    flags += [("--process", _absolute_path(options.process, document))] if options.process else []
    process_files: dict[str, bytes] = {}
    if options.material:
        process_files = _process_files(_posted_job(document, objects), name, options.material)
        flags.append(("--process", f"{name}.process.toml"))
    flags += [("--tolerance", options.tolerance)] if options.tolerance else []
    flags += [("--nominal", "")] if options.nominal else []
    conversion = convert(blocks, folder, name, "nc", flags, process_files)
    for warning in conversion.warnings:
        FreeCAD.Console.PrintWarning(f"{warning}\n")
    if "modules" in conversion.summary:
        names = ", ".join(module["name"] for module in conversion.summary["modules"])
        raise HostError(
            f"The program is larger than the memory of the controller, and FreeCAD takes one text. It is in {folder} "
            f"as {names}: load these files one after another. Delete the file that FreeCAD may write."
        )
    program = conversion.files[0]
    text: str = program.read_bytes().decode("utf-8")
    console = FreeCAD.Console
    print_line = {"ok": console.PrintMessage, "warning": console.PrintWarning, "failed": console.PrintError}[
        conversion.state
    ]
    for line in conversion.verdict:
        print_line(f"{line}\n")
    console.PrintMessage(f"{program}; report: {program.with_suffix('.report.html')}\n")
    return text


def _show(FreeCAD: Any, message: str) -> None:
    """Show a message where the user of FreeCAD looks."""
    FreeCAD.Console.PrintError(f"{message}\n")
    if FreeCAD.GuiUp:
        from PySide import QtGui

        QtGui.QMessageBox.critical(None, "KUKA, corrected: nothing is written", message)


def _parsed_arguments(argstring: str) -> argparse.Namespace:
    """Return the arguments of the job; Windows paths need no escapes."""
    return _parser.parse_args(shlex.split(argstring, posix="\\" not in argstring))


def _absolute_path(path: str, document: Any) -> str:
    """Return a path as absolute; a relative one starts at the folder of the document."""
    if not path:
        return ""
    folder = Path(document.FileName).parent if document is not None and document.FileName else Path.cwd()
    return str((folder / path.strip("\"'")).resolve())


def _folder_and_name(options: argparse.Namespace, filename: str, document: Any, objects: list[Any]) -> tuple[Path, str]:
    """Return the folder to write into and the name of the program."""
    target = None if filename in ("", "-") else Path(filename)
    if options.out_dir:
        folder = Path(_absolute_path(options.out_dir, document))
    elif target is not None:
        folder = target.resolve().parent
    else:
        folder = Path(_absolute_path("corrected", document))
        target = _output_file(document, objects)
    name = options.name or (target.stem if target is not None else document.Label if document is not None else "part")
    name = re.sub("[^A-Za-z0-9_]", "_", name)[:24]
    name = name if re.match("[A-Za-z]", name) else f"P{name}"[:24]
    if filename == "-":
        _names.append(name)
        count = _names.count(name)
        name = name if count == 1 else f"{name[:21]}_{count}"
    return folder, name


def _posted_job(document: Any, objects: list[Any]) -> Any:
    """Return the job that is posted, of which FreeCAD hands over the operations; None: none of the document."""
    posted_names = {getattr(item, "Name", None) for item in objects}
    for job in [] if document is None else document.Objects:
        if hasattr(job, "PostProcessorOutputFile") and posted_names & {item.Name for item in job.Operations.Group}:
            return job
    return None


def _output_file(document: Any, objects: list[Any]) -> Path | None:
    """Return the output file of the job that is posted, which FreeCAD from 1.0 on writes itself; None: it has none."""
    file = getattr(_posted_job(document, objects), "PostProcessorOutputFile", "")
    return Path(file) if file and "%" not in file else None


_SHAPES = {"endmill": "flat", "ballend": "ball", "bullnose": "bull", "drill": "drill"}
"""Tool shapes of FreeCAD and their names in a process file."""
_CELLS = 4e6
"""Cells of the map of the stock (assumed)."""
_SMALLEST_CELL = 0.25
"""Smallest edge of a cell [mm] (assumed)."""
_CELL_STEPS = 20
"""Steps of the edge of a cell in a millimetre: it is rounded up to 0.05 mm."""
_BOX_TOLERANCE = 1e-6
"""Difference of the volumes of a stock and its bounding box, over the volume, up to which the stock is the box."""


def _cell_size(area: float) -> float:
    """Return the edge [mm] of the cells of the map of a stock that covers an area [mm²]."""
    return max(_SMALLEST_CELL, math.ceil(math.sqrt(area / _CELLS) * _CELL_STEPS) / _CELL_STEPS)


def _process_files(job: Any, name: str, material: str) -> dict[str, bytes]:
    """Return the process file of a job, and the mesh of its stock if that is no box: file name → content.

    :param name: of the program.
    :param material: name of the material.
    :raises HostError: the job is not known, has no stock, or a tool whose forces cannot be computed.
    """
    if job is None:
        raise HostError("--material: the job of these operations is not found: post the job as a whole.")
    text = [f"# {one_line(job.Label)}: as the job states it", "[material]", f"name = {json.dumps(material)}", ""]
    for number, controller in sorted(_tool_controllers(job).items()):
        text += [f"[tools.{number}]  # {_comment(controller.Label)}", *_tool_lines(controller), ""]
    stock = getattr(getattr(job, "Stock", None), "Shape", None)
    if stock is None or stock.isNull() or not stock.Volume > 0.0:
        raise HostError(f"--material: {job.Label} has no stock: set it in the job's Setup tab.")
    box = stock.BoundBox
    text += [
        "[stock]",
        f"resolution_mm = {_cell_size(box.XLength * box.YLength):g}",
    ]
    if abs(stock.Volume - box.XLength * box.YLength * box.ZLength) < _BOX_TOLERANCE * stock.Volume:
        spans = ((box.XMin, box.XMax), (box.YMin, box.YMax), (box.ZMin, box.ZMax))
        sides = ", ".join(f"{axis} = [{a:.6f}, {b:.6f}]" for axis, (a, b) in zip("XYZ", spans))
        text.append(f"box = {{ {sides} }}")
        return {f"{name}.process.toml": "\n".join([*text, ""]).encode()}
    text.append(f'file = "{name}.stock.stl"')
    return {f"{name}.process.toml": "\n".join([*text, ""]).encode(), f"{name}.stock.stl": _stl_bytes(stock)}


def _tool_controllers(job: Any) -> dict[int, Any]:
    """Return the tool controllers of the operations of a job by tool number; a dress-up has that of its operation."""
    controllers: dict[int, Any] = {}
    for operation in job.Operations.Group:
        controller = getattr(operation, "ToolController", None) or getattr(
            getattr(operation, "Base", None), "ToolController", None
        )
        if controller is not None:
            controllers[int(controller.ToolNumber)] = controller
    return controllers


def _tool_lines(controller: Any) -> list[str]:
    """Return the lines of [tools.n] of a process file: shape, diameter, flutes.

    :param controller: tool controller of FreeCAD.
    :raises HostError: the shape is not known, or diameter or flutes are not stated.
    """
    tool, subject = controller.Tool, f"--material: tool {int(controller.ToolNumber)}, {controller.Label}"
    name = next((str(getattr(tool, key)) for key in ("ShapeName", "ShapeID", "ShapeType") if hasattr(tool, key)), "")
    shape = _SHAPES.get(re.sub("[^a-z]", "", name.lower()))
    if shape is None:
        raise HostError(
            f"{subject}: forces of the shape {name!r} are not known, but of {', '.join(_SHAPES)}. "
            "Give --process FILE.toml."
        )
    diameter, flutes = _property_number(tool, "Diameter"), int(_property_number(tool, "Flutes"))
    if diameter <= 0.0 or flutes < 1:
        quantity = "diameter" if diameter <= 0.0 else "number of flutes"
        raise HostError(
            f"{subject} states no {quantity}: set it in the tool (Flutes, Diameter), or give --process FILE.toml."
        )
    lines = [f'shape = "{shape}"', f"diameter_mm = {diameter:.6g}", f"flutes = {flutes}"]
    if shape == "bull":
        corner = _property_number(tool, "CornerRadius") or 0.5 * diameter - _property_number(tool, "FlatRadius")
        lines.append(f"corner_radius_mm = {corner:.6g}")
    return lines


def _property_number(item: Any, key: str) -> float:
    """Return a property as a number, lengths in mm; 0 where there is none."""
    value = getattr(item, key, 0.0)
    return float(getattr(value, "Value", value))


def _stl_bytes(shape: Any) -> bytes:
    """Return a shape as a binary STL in mm."""
    points, facets = shape.tessellate(0.05)
    rows = [struct.pack("<80xI", len(facets))]
    rows += [struct.pack("<12x9fH", *(c for corner in facet for c in points[corner]), 0) for facet in facets]
    return b"".join(rows)


def _blocks(objects: list[Any]) -> list[Block]:
    """Return the program as blocks of G-code, each with the operation and command it is from.

    :raises HostError: an object has no path.
    """
    blocks = [Block("G17 G21 G40 G49 G80 G90 G94", "start")]
    for item in objects:
        if not hasattr(item, "Path"):
            raise HostError(f"{item.Label} has no path: select the job, or operations of it.")
        if not getattr(item, "Active", True) or not getattr(getattr(item, "Base", None), "Active", True):
            continue
        place = f"operation {item.Label}"
        blocks.append(Block(f"({_comment(item.Label)})", place))
        coolant = _coolant(item)
        blocks += [Block(code, place) for code in _COOLANT_CODES.get(coolant, ())]
        for number, command in enumerate(item.Path.Commands, start=1):
            text = _gcode_block(command)
            if text:
                blocks.append(Block(text, f"{place}, command {number} ({text})"))
        blocks += [Block("M9", place)] * bool(_COOLANT_CODES.get(coolant))
    return [*blocks, Block("M5", "end"), Block("M2", "end")]


_COOLANT_CODES = {"Flood": ("M8",), "Mist": ("M7",)}


def _coolant(item: Any) -> str:
    """Return the mode of coolant of an operation, or of the operation that a dress-up changes."""
    holder = item if hasattr(item, "CoolantMode") else getattr(item, "Base", None)
    return str(getattr(holder, "CoolantMode", "None"))


def _comment(text: str) -> str:
    """Return a text that can be a comment of G-code: one line, without brackets."""
    return re.sub("[()]", " ", one_line(text))


def _gcode_block(command: Any) -> str:
    """Return a command of FreeCAD as a block of G-code; empty for a message, which moves nothing."""
    name: str = command.Name
    if name.startswith("("):
        return f"({_comment(name).strip()})"
    if name == "message":
        return ""
    words = dict(command.Parameters)
    if name in ("G0", "G00") or words.get("F") == 0.0:  # FreeCAD writes F0 where no feed is meant
        words.pop("F", None)
    for letter in "IJK":  # FreeCAD writes all three in every plane
        if words.get(letter) == 0.0:
            del words[letter]
    letters = [letter for letter in _WORDS if letter in words]
    return " ".join(
        [name, *(_gcode_word(letter, words[letter]) for letter in (*letters, *sorted(set(words) - set(letters))))]
    )


def _gcode_word(letter: str, value: float) -> str:
    """Return a word of G-code; FreeCAD has feeds in mm/s, F is in mm/min."""
    if value == int(value):
        return f"{letter}{int(value) * (60 if letter == 'F' else 1)}"
    return f"{letter}{value * (60.0 if letter == 'F' else 1.0):.7f}".rstrip("0").rstrip(".")


def _machine_class() -> type | None:
    """Return the class that FreeCAD 1.2 looks for; None in older versions, which call `export` of this script.

    FreeCAD 1.2 calls the method `export2` for a job that names a machine. Its own `export2` for scripts like this one
    writes G-code without correction; that of the class returned here writes corrected KRL.
    """
    try:
        from Path.Post.Processor import WrapperPost
    except ImportError:
        return None
    if not hasattr(WrapperPost, "export2"):
        return None

    class MachineBased(WrapperPost):  # type: ignore[misc]
        """The post for jobs with a machine; without one, FreeCAD's own `export` calls that of the script."""

        def __init__(self, job: Any) -> None:
            """Load the script for a job, or for the editor of machines (None)."""
            super().__init__(job, __file__, Path(__file__).stem)

        @classmethod
        def get_property_schema(cls) -> list[dict[str, Any]]:
            """Return the property of a machine that this post has."""
            text = {"name": "arguments", "type": "string", "label": "Arguments", "default": "", "help": TOOLTIP_ARGS}
            return [text]

        def get_file_extension(self) -> str:
            """Return the extension of the file that FreeCAD writes."""
            return "src"

        def export2(self) -> list[tuple[str, str]]:
            """Return name and corrected KRL of each section; the arguments are the machine's, else the job's."""
            machine_arguments = getattr(self._machine, "postprocessor_properties", {}).get("arguments", "")
            arguments = machine_arguments or self._job.PostProcessorArgs
            return [(name, export(items, "-", arguments)) for name, items in self._buildPostList()]

    return MachineBased


if (_class := _machine_class()) is not None:
    Kuka_Compensated = _class  # the name that FreeCAD makes of that of the file
