"""The post as FreeCAD 1.0 and later call it: a stand-in that follows their loader, wrapper and list of things to post.

Read in FreeCAD's sources, `Mod/CAM/Path/Post/Processor.py` (`PostProcessorFactory`, `WrapperPost`) and `PostList.py`
(`Postable`): a post is found by its file name, loaded from its path, asked for a class of its name, loaded once more as
a script, and its `export` is called with "-" for each section; FreeCAD writes the text. In 1.2 the wrapper inherits
`export2`, which posts jobs that name a machine, and writes G-code itself. It was not run in a FreeCAD newer than 0.20.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace

import pytest

from postproc.hosts import install_post
from tests.commands import invoke
from tests.places import CELL_FILE


@dataclass(frozen=True)
class Command:
    Name: str
    Parameters: dict


@dataclass(eq=False)
class Object:
    """A document object: an operation or a tool controller."""

    Label: str
    Path: object
    Name: str
    more: dict = field(default_factory=dict)

    def __getattr__(self, name):
        try:
            return self.__dict__["more"][name]
        except KeyError:
            raise AttributeError(f"'Path.FeaturePython' object has no attribute '{name}'") from None


class Postable:
    """What is posted from 1.1 on: a copy of the path, all else asked of the document object behind it."""

    def __init__(self, label, commands, source=None):
        self.item_type, self.label, self.source = "operation" if source else "fixture", label, source
        self.path, self.data = SimpleNamespace(Commands=list(commands)), {}

    @property
    def Path(self):
        return self.path

    @property
    def Label(self):
        return self.label

    def __getattr__(self, name):
        source = object.__getattribute__(self, "source")
        if source is not None:
            return getattr(source, name)
        if name == "Name":
            return self.label
        raise AttributeError(f"'Postable' object has no attribute '{name}'")


def commands(*lines):
    """Commands of FreeCAD: lengths in mm, feeds in mm/s."""
    out = []
    for line in lines:
        name, *words = line.split()
        out.append(Command(name, {word[0]: float(word[1:]) / (60.0 if word[0] == "F" else 1.0) for word in words}))
    return out


def job():
    """A job with two operations by two tools, and the sections that are posted of it."""
    tools = [
        Object(f"TC {number}", SimpleNamespace(Commands=commands(f"M6 T{number}", "M3 S9000")), f"TC__{number}")
        for number in (1, 2)
    ]
    operations = [
        Object(
            name,
            SimpleNamespace(Commands=[Command("(FORCE FX=200 FY=100 FZ=150)", {}), *commands(
                f"G0 Z{z + 20}", f"G0 X0 Y{y}", f"G0 Z{z + 2}", f"G1 Z{z} F300", f"G1 X60 Y{y} Z{z} F1200",
                f"G2 X60 Y{y + 20} I0 J10 K0 F1200", f"G0 Z{z + 20}",
            )]),
            f"{name}001",
            {"CoolantMode": coolant, "Active": True},
        )
        for name, y, z, coolant in (("Pocket", 0, -2, "None"), ("Profile", 30, -4, "Flood"))
    ]  # fmt: skip
    return operations, tools


def section(operation, tool, wrapped):
    """A section: fixture, tool change, operation; raw document objects in 1.0, wrapped from 1.1 on."""
    fixture = Postable("Fixture", commands("G54"))
    if not wrapped:
        fixture = SimpleNamespace(Label="Fixture", Path=fixture.path, InList=[])
        return [fixture, tool, operation]
    return [fixture, *(Postable(item.Label, item.Path.Commands, item) for item in (tool, operation))]


def post(folder, arguments, sections):
    """Find, load and call the post as FreeCAD does; return the text of each section."""

    def loaded():
        spec = importlib.util.spec_from_file_location("kuka_compensated_post", folder / "kuka_compensated_post.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    with pytest.raises(AttributeError, match="has no attribute 'Kuka_Compensated'"):
        getattr(loaded(), "kuka_compensated".title())
    script = loaded()
    assert script.UNITS == "G21"
    assert "--cell" in script.TOOLTIP_ARGS
    assert script.TOOLTIP.strip()
    return [script.export(items, "-", arguments) for items in sections]


@pytest.fixture
def freecad(monkeypatch, tmp_path):
    """The module FreeCAD with a document; returns the folder of the post, and what is said."""
    said = []
    module = ModuleType("FreeCAD")
    module.GuiUp = False
    module.Console = SimpleNamespace(PrintMessage=said.append, PrintWarning=said.append, PrintError=said.append)
    module.ActiveDocument = SimpleNamespace(FileName=str(tmp_path / "bracket.FCStd"), Label="Unnamed", Objects=[])
    monkeypatch.setitem(sys.modules, "FreeCAD", module)
    monkeypatch.delitem(sys.modules, "postproc_host", raising=False)  # that of a post which another test installed
    posts = tmp_path / "posts"
    posts.mkdir()
    install_post("freecad", posts)
    return posts, module.ActiveDocument, said


def in_document(document, operations, file):
    """Put the job into the document."""
    group = SimpleNamespace(Group=operations)
    document.Objects += [SimpleNamespace(Label="Body"), SimpleNamespace(PostProcessorOutputFile=file, Operations=group)]


@pytest.mark.parametrize("wrapped", [False, True], ids=["1.0", "1.1"])
def test_a_job_is_posted_and_its_program_called_as_the_file_that_freecad_writes(freecad, tmp_path, wrapped):
    posts, document, said = freecad
    operations, tools = job()
    in_document(document, operations, "/parts/bracket_1.src")
    items = [item for pair in zip(operations, tools, strict=True) for item in section(*pair, wrapped)]
    (text,) = post(posts, f"--cell {CELL_FILE}", [items])
    assert text.encode() == (tmp_path / "corrected" / "bracket_1.src").read_bytes()
    assert "DEF bracket_1(" in text
    report = json.loads((tmp_path / "corrected" / "bracket_1.report.json").read_text())
    assert report["before"]["max_mm"] > 0.1
    assert report["after"]["max_mm"] < 0.001
    assert text.index("FORCE FX") < text.index("CIRC {")
    verdict = report["verdict"]
    assert [line for line in said if line.startswith((verdict["headline"], *verdict["answers"]))] == [
        f"{line}\n" for line in (verdict["headline"], *verdict["answers"])
    ]
    assert "uncorrected up to" in verdict["answers"][1]


@pytest.mark.parametrize("wrapped", [False, True], ids=["1.0", "1.1"])
def test_sections_of_a_job_that_splits_its_output_do_not_replace_each_other(freecad, tmp_path, wrapped):
    posts, document, _ = freecad
    operations, tools = job()
    in_document(document, operations, "/parts/%D.src")
    sections = [section(*pair, wrapped) for pair in zip(operations, tools, strict=True)]
    first, second = post(posts, f"--cell {CELL_FILE}", sections)
    assert "DEF Unnamed(" in first
    assert "DEF Unnamed_2(" in second
    out = tmp_path / "corrected"
    assert [(out / f"{name}.src").read_bytes() for name in ("Unnamed", "Unnamed_2")] == [
        first.encode(),
        second.encode(),
    ]
    assert post(posts, f"--cell {CELL_FILE}", sections[:1]) == [first]  # the next run begins anew


def test_a_fault_names_operation_and_command(freecad, tmp_path):
    posts, _, said = freecad
    operations, tools = job()
    operations[1].Path.Commands.append(Command("G1", {"X": 9000.0}))
    with pytest.raises(Exception, match="out of reach"):
        post(posts, f"--cell {CELL_FILE}", [section(operations[1], tools[1], wrapped=True)])
    assert any("operation Profile, command 9 (G1 X9000)" in line for line in said)
    assert list((tmp_path / "corrected").glob("*")) == []


def test_modules_are_not_given_to_freecad_as_one_text(freecad, tmp_path):
    posts, document, said = freecad
    operations, tools = job()
    operations[0].Path.Commands = 20 * operations[0].Path.Commands
    in_document(document, operations, "/parts/bracket.src")
    cell = tmp_path / "small.toml"
    small = "[output]\ndivide_into_modules = true\nprogram_memory_MB = 0.008"
    cell.write_text(CELL_FILE.read_text().replace("[output]", small))
    with pytest.raises(Exception, match="FreeCAD takes one text"):
        post(posts, f"--cell {cell}", [section(operations[0], tools[0], wrapped=True)])
    assert (tmp_path / "corrected" / "bracket_2.src").exists()
    assert any("as bracket_1.src, bracket_2.src" in line for line in said)


@pytest.mark.parametrize("state", ["ok", "warning", "failed"])
def test_a_program_is_posted_with_its_verdict_unless_it_may_not_be_driven(freecad, tmp_path, monkeypatch, state):
    posts, *_ = freecad
    spec = importlib.util.spec_from_file_location("postproc_host", posts / "postproc_host" / "__init__.py")
    host = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "postproc_host", host)
    spec.loader.exec_module(host)
    run = host._summary_of_run

    def judged(words):
        content = run(words)
        drive = {"state": state, "reasons": ["the spindle hits the vice"], "unchecked": []}
        answers = ["May it be driven? no", "Is it better?", "Does it hold?"]
        verdict = {"state": state, "headline": "As judged.", "answers": answers, "drive": drive, "reasons": ["why"]}
        content["programs"][0]["verdict"] = verdict
        return content

    monkeypatch.setattr(host, "_summary_of_run", judged)
    block = [host.Block(line, "start") for line in ("G90 G21", "G0 X0 Y0 Z50", "G1 Z-1 F500", "G1 X50", "M2")]
    given = block, tmp_path / "out", "part", "nc", [("--cell", str(CELL_FILE))]
    if state == "failed":
        with pytest.raises(host.HostError, match=r"As judged.\nthe spindle hits the vice"):
            host.convert(*given)
        assert not list((tmp_path / "out").glob("part*"))
        return
    done = host.convert(*given)
    answers = ["As judged.", "May it be driven? no", "Is it better?", "Does it hold?"]
    assert (done.state, done.verdict) == (state, answers + ([] if state == "ok" else ["why"]))


class PostProcessor:
    """Base class of FreeCAD 1.2 (development version of 2026), as far as the post uses it."""

    def __init__(self, job, tooltip, tooltipargs, units):
        self._job, self._machine = job, getattr(job, "machine", None)
        self._tooltip, self._tooltipargs, self._units = tooltip, tooltipargs, units

    def _buildPostList(self, early_tool_prep=False):
        return self._job.sections

    def export2(self):
        return [("allitems", "G1 X0 (not corrected)")]


class WrapperPost(PostProcessor):
    """Wrapper of scripts, as in FreeCAD 1.2."""

    def __init__(self, job, script_path, module_name):
        super().__init__(job, tooltip=None, tooltipargs=None, units=None)
        spec = importlib.util.spec_from_file_location(module_name, script_path)
        self.script_module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.script_module)

    def export(self):
        return [
            (name, self.script_module.export(items, "-", self._job.PostProcessorArgs))
            for name, items in self._buildPostList()
        ]


@pytest.mark.parametrize("machine", [False, True], ids=["legacy", "machine-based"])
def test_freecad_1_2_posts_a_job_with_and_without_a_machine_to_the_same_program(freecad, monkeypatch, machine):
    posts, document, _ = freecad
    for name in ("Path", "Path.Post", "Path.Post.Processor"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules["Path.Post.Processor"].WrapperPost = WrapperPost
    operations, tools = job()
    in_document(document, operations, "/parts/bracket.src")
    items = [item for pair in zip(operations, tools, strict=True) for item in section(*pair, wrapped=True)]
    asked = SimpleNamespace(sections=[("allitems", items)], PostProcessorArgs=f"--cell {CELL_FILE}")
    spec = importlib.util.spec_from_file_location("kuka_compensated_post", posts / "kuka_compensated_post.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if machine:
        asked.machine = SimpleNamespace(postprocessor_properties={"arguments": f"--cell {CELL_FILE}"})
        asked.PostProcessorArgs = ""
    processor = module.Kuka_Compensated(asked)
    ((name, text),) = processor.export2() if machine else processor.export()
    assert name == "allitems"
    assert text.startswith("&ACCESS RVP")
    assert "LIN {" in text
    assert processor.get_file_extension() == "src"
    assert [one["name"] for one in module.Kuka_Compensated.get_property_schema()] == ["arguments"]


def test_freecad_1_2_would_write_the_path_without_correction_by_its_own_wrapper():
    assert "not corrected" in WrapperPost.export2(SimpleNamespace())[0][1]


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        (["Macro"], "Macro"),
        (["Macro", "v1-1/Macro"], "v1-1/Macro"),
        (["Macro", "v1-1/Macro", "v1-2", "v1-10/Macro"], "v1-10/Macro"),
        (["Macro", "v1-2"], "v1-2/Macro"),  # no macro was written yet
        (["Mod"], "Macro"),
    ],
)
def test_the_post_goes_where_the_newest_freecad_looks(tmp_path, monkeypatch, there, taken):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    own = tmp_path / ".local" / "share" / "FreeCAD"
    for folder in there:
        (own / folder).mkdir(parents=True)
    done = invoke("install-post", "freecad")
    assert done.exit_code == 0, done.output
    assert (own / taken / "kuka_compensated_post.py").is_file()
    assert "--cell CELL.toml --material NAME" in done.output


def test_without_freecad_the_message_says_where_it_was_looked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    done = invoke("install-post", "freecad")
    assert done.exit_code == 1
    assert "FreeCAD is in none of its usual places (~/.local/share/FreeCAD/v*/Macro" in done.output
    assert "--dir" in done.output
