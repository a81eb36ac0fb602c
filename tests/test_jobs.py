from __future__ import annotations

import errno
import os
import signal
from pathlib import Path

import pytest

from postproc import jobs
from postproc.errors import ForceError, InputError, Issue, PostprocError, ProgramError, SubprogramError
from postproc.jobs import Job, Settings, convert_all, find_jobs, programs
from tests import fabricated
from tests.places import CELL_FILE


@pytest.fixture
def computed(monkeypatch):
    """Replace the computation: every program gives a made-up result."""
    monkeypatch.setattr("postproc.correction.read", lambda *_: fabricated.zigzag_program())
    monkeypatch.setattr("postproc.correction.process", lambda *_, **__: fabricated.result())


def _touch(*names: str) -> None:
    for name in names:
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("G0 X0\n")


def _names(jobs: list[Job]) -> list[str]:
    return [job.program.as_posix() for job in jobs]


def test_folders_and_patterns_become_sorted_programs_each_once(work_folder):
    _touch("p/b.nc", "p/a.NGC", "p/c.src", "p/c.dat", "p/notes.txt", "q/x.tap")
    assert _names(find_jobs(["p"])) == ["p/a.NGC", "p/b.nc", "p/c.src"]
    assert _names(find_jobs(["p/*.nc", "p", "q/x.tap"])) == ["p/b.nc", "p/a.NGC", "p/c.src", "q/x.tap"]
    assert _names(find_jobs(["**/*.tap"])) == ["q/x.tap"]
    assert _names(find_jobs(["p/*.txt"], dialect="gcode")) == ["p/notes.txt"]


def test_dialect_comes_from_the_extension_in_any_case(work_folder):
    _touch("a.MPF", "b.SRC")
    assert [job.dialect for job in find_jobs(["a.MPF", "b.SRC"])] == ["gcode", "krl"]


def test_output_goes_beside_each_program_by_default(work_folder):
    _touch("p/a.nc", "q/b.nc")
    assert [job.output.as_posix() for job in find_jobs(["p", "q"])] == ["p/corrected", "q/corrected"]
    assert [job.output.as_posix() for job in find_jobs(["p", "q"], output=Path("out"))] == ["out", "out"]


def test_file_whose_name_looks_like_a_pattern_is_taken_as_it_is(work_folder):
    _touch("a[1].nc", "a1.nc")
    assert _names(find_jobs(["a[1].nc"])) == ["a[1].nc"]


@pytest.mark.parametrize(
    ("name", "message"),
    [("empty", "no program in this folder"), ("*.nc", "matches no program"), ("part.txt", "unknown kind of program")],
)
def test_input_that_names_no_program_is_an_error(work_folder, name, message):
    (work_folder / "empty").mkdir()
    with pytest.raises(InputError, match=message):
        find_jobs([name])


def test_a_dat_alone_is_an_error_with_advice(work_folder):
    _touch("part.dat")
    with pytest.raises(ProgramError, match=r"Give the \.src file"):
        find_jobs(["part.dat"])


@pytest.mark.parametrize("pair", [("a/part.nc", "b/part.nc"), ("a/part.nc", "b/PART.tap"), ("a/part.nc", "a/part.src")])
def test_two_programs_that_would_be_one_file_are_an_error_before_anything_is_written(work_folder, pair):
    _touch(*pair)
    with pytest.raises(InputError, match="would both be written as"):
        list(convert_all(find_jobs(pair, output=Path("out")), Settings(CELL_FILE)))
    assert not Path("out").exists()


def test_programs_of_one_name_in_two_folders_are_no_clash_by_default(work_folder, computed):
    _touch("a/part.nc", "b/part.nc")
    assert [outcome.code for outcome in convert_all(find_jobs(["a", "b"]), Settings(CELL_FILE))] == [0, 0]


@pytest.mark.parametrize(
    ("program", "options"),
    [
        ("part.src", {"output": Path()}),
        ("part.nc", {"output": Path(), "forces": Path("part.targets.csv")}),
        ("part.nc", {"output": Path(), "cell": Path("part.report.json")}),
    ],
)
def test_an_input_is_never_overwritten(work_folder, program, options):
    _touch(program, "part.targets.csv", "part.report.json")
    cell = options.pop("cell", CELL_FILE)
    with pytest.raises(InputError, match="this input would be overwritten"):
        list(convert_all(find_jobs([program], **options), Settings(cell, overwrite=True)))


def test_the_program_itself_is_not_overwritten_whatever_it_is_called(work_folder, computed):
    _touch("part.src")
    settings = Settings(CELL_FILE)
    with pytest.raises(InputError, match="would be overwritten"):
        list(convert_all([Job(Path("part.src"), "gcode", Path())], settings))
    assert Path("part.src").read_text() == "G0 X0\n"


def test_a_krl_program_takes_the_dat_beside_it_in_any_case(work_folder):
    Path("Part.src").write_text("DEF Part()\nEND\n")
    Path("PART.DAT").write_text("DEFDAT PART\nENDDAT\n")
    assert [document.name for document in jobs.read_documents(Path("Part.src"), "krl")] == ["Part.src", "PART.DAT"]
    assert [document.name for document in jobs.read_documents(Path("Part.src"), "gcode")] == ["Part.src"]


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such file"), (b"", "empty"), (b"G0\0X1", "binary"), (b" \n \n", "empty")],
)
def test_unusable_program_file_is_told_with_its_name(work_folder, content, message):
    if content is not None:
        Path("part.nc").write_bytes(content)
    with pytest.raises(ProgramError, match=message) as caught:
        jobs.read_documents(Path("part.nc"), "gcode")
    assert caught.value.file == "part.nc"


def test_one_force_file_for_many_programs_is_an_error_with_advice(work_folder):
    _touch("a.nc", "b.nc", "f.csv")
    assert find_jobs(["a.nc"], forces=Path("f.csv"))[0].forces == Path("f.csv")
    with pytest.raises(ForceError, match=r"one force file for 2 programs.*Give a folder"):
        find_jobs(["a.nc", "b.nc"], forces=Path("f.csv"))


def test_a_folder_of_forces_gives_each_program_its_own(work_folder):
    _touch("a.nc", "b.nc", "c.nc", "f/a.csv", "f/B.forces.csv")
    jobs = find_jobs(["a.nc", "b.nc", "c.nc"], forces=Path("f"))
    assert [job.forces for job in jobs] == [Path("f/a.csv"), Path("f/B.forces.csv"), None]
    with pytest.raises(ForceError, match="no force file for any"):
        find_jobs(["c.nc"], forces=Path("f"))


def test_all_files_of_a_program_are_written_and_named(work_folder, computed):
    _touch("part.nc")
    (outcome,) = convert_all(find_jobs(["part.nc"]), Settings(CELL_FILE))
    assert outcome.code == 0
    assert [Path(path).name for path in outcome.written_files] == [
        "part.src", "part.targets.csv", "part.report.html", "part.report.json",
    ]  # fmt: skip
    assert sorted(path.name for path in Path("corrected").iterdir()) == sorted(
        Path(path).name for path in outcome.written_files
    )


def test_one_failing_program_does_not_stop_the_others(work_folder, computed, monkeypatch):
    _touch("a.nc", "b.nc", "c.nc", "d.nc")

    def process(program, *_, **__):
        raise {"a": ForceError("bad force", line=3), "b": ZeroDivisionError("oops"), "c": MemoryError()}[program]

    monkeypatch.setattr("postproc.correction.read", lambda documents, *_: documents[0].name[0])
    good = fabricated.result()
    monkeypatch.setattr("postproc.correction.process", lambda p, *a, **k: good if p == "d" else process(p))
    outcomes = list(convert_all(find_jobs(["a.nc", "b.nc", "c.nc", "d.nc"]), Settings(CELL_FILE)))
    assert [outcome.code for outcome in outcomes] == [1, 1, 1, 0]
    assert "bad force" in outcomes[0].message
    assert "unexpected ZeroDivisionError" in outcomes[1].message
    assert "ZeroDivisionError: oops" in outcomes[1].traceback
    assert "memory" in outcomes[2].message
    assert [path.name for path in Path("corrected").iterdir() if path.suffix == ".src"] == ["part.src"]


def test_a_program_with_an_error_is_not_written_and_says_why(work_folder, computed, monkeypatch):
    issue = Issue("error", "unreachable", "out of reach", 12)
    failed = fabricated.with_changes(fabricated.result(), issues=(issue,), documents=())
    monkeypatch.setattr("postproc.correction.process", lambda *_, **__: failed)
    _touch("part.nc")
    (outcome,) = convert_all(find_jobs(["part.nc"]), Settings(CELL_FILE))
    assert (outcome.code, outcome.issues, outcome.written_files) == (1, (issue,), ())
    assert not Path("corrected").exists()


def test_an_exceeded_tolerance_counts_only_where_one_is_stated(work_folder, computed, monkeypatch):
    monkeypatch.setattr("postproc.correction.process", lambda *_, **__: fabricated.result(mode="nominal"))
    _touch("part.nc")
    jobs = find_jobs(["part.nc"])
    assert [o.code for o in convert_all(jobs, Settings(CELL_FILE, "nominal"))] == [0]
    assert [o.code for o in convert_all(jobs, Settings(CELL_FILE, "nominal", 5.0))] == [0]
    (outcome,) = convert_all(jobs, Settings(CELL_FILE, "nominal", 0.1))
    assert outcome.code == 3
    assert len(outcome.written_files) == 4


def test_messages_name_the_program_by_its_path(work_folder, computed, monkeypatch):
    def read(*_):
        raise ProgramError("odd word", file="part.nc", line=7, text="G999", advice="Remove it.")

    monkeypatch.setattr("postproc.correction.read", read)
    _touch("deep/down/part.nc")
    (outcome,) = convert_all(find_jobs(["deep/down/part.nc"]), Settings(CELL_FILE))
    assert outcome.message == f"{Path('deep/down/part.nc')}:7: odd word. Text: 'G999'. Remove it."


def test_a_file_in_the_place_of_the_output_folder_is_a_failure(work_folder, computed):
    _touch("part.nc", "out")
    (outcome,) = convert_all(find_jobs(["part.nc"], output=Path("out")), Settings(CELL_FILE))
    assert outcome.code == 1
    assert "cannot be written" in outcome.message
    assert Path("out").read_text() == "G0 X0\n"


@pytest.mark.parametrize("failing", [1, 2, 3, 4])
def test_a_full_disk_leaves_nothing_half_written(work_folder, computed, monkeypatch, failing):
    _touch("part.nc")
    calls = []

    def fsync(_):
        calls.append(1)
        if len(calls) == failing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", fsync)
    (outcome,) = convert_all(find_jobs(["part.nc"], output=Path("out")), Settings(CELL_FILE))
    assert outcome.code == 1
    assert "No space left on device" in outcome.message
    assert not Path("out").exists()


def test_an_interrupt_while_writing_leaves_nothing_and_is_passed_on(work_folder, computed, monkeypatch):
    _touch("part.nc")

    def fsync(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", fsync)
    with pytest.raises(KeyboardInterrupt):
        list(convert_all(find_jobs(["part.nc"], output=Path("out")), Settings(CELL_FILE)))
    assert not Path("out").exists()


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
def test_an_interrupt_while_files_are_replaced_waits_for_the_program_to_be_whole(work_folder, computed, monkeypatch):
    _touch("a.nc", "b.nc")
    replace = Path.replace

    def interrupted(path, target):
        signal.raise_signal(signal.SIGINT)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    outcomes = convert_all(find_jobs(["a.nc", "b.nc"], output=Path("out")), Settings(CELL_FILE))
    assert len(next(outcomes).written_files) == 4
    with pytest.raises(KeyboardInterrupt):
        next(outcomes)
    assert {path.name.split(".")[0] for path in Path("out").iterdir()} == {"a", "part"}
    assert len(list(Path("out").iterdir())) == 4
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_subprogram_of_a_folder_is_skipped_and_said_to_be_one(work_folder, computed, monkeypatch):
    def read(documents, *_):
        if documents[0].name == "sub.nc":
            raise SubprogramError("this is a subprogram, O<sub>", file="sub.nc")
        return fabricated.zigzag_program()

    monkeypatch.setattr("postproc.correction.read", read)
    _touch("p/part.nc", "p/sub.nc")
    part, sub = convert_all(find_jobs(["p"]), Settings(CELL_FILE))
    assert (part.code, sub.code, sub.is_skipped, part.is_skipped) == (0, 0, True, False)
    assert "a subprogram" in sub.message
    assert "called by others" in Path("p/corrected/index.html").read_text()
    (alone,) = convert_all(find_jobs(["p/sub.nc"]), Settings(CELL_FILE))
    assert (alone.code, alone.is_skipped) == (1, False)


def test_an_unusable_cell_is_one_error_for_all(work_folder):
    _touch("a.nc", "b.nc")
    with pytest.raises(PostprocError, match="no such file"):
        list(convert_all(find_jobs(["a.nc", "b.nc"]), Settings(Path("none.toml")), workers=2))


@pytest.mark.parametrize(
    ("text", "is_stated"),
    [
        (";FORCE FX=1", True),
        ("(FORCE FX=1)", True),
        ("! FORCE OFF", True),
        ("PPRINT/'FORCE FX=3'", True),
        ("$$ FORCE FX=1 FRAME=TOOL", True),
        ("$FORCE FX=1", False),
        ("; force the door\n; FORCE FX=2", True),
        ("; Force exact path", False),
        ("FORCE FX=1", False),
    ],
)
def test_comments_on_forces_are_told_from_prose_as_the_readers_do(tmp_path, text, is_stated):
    (tmp_path / "part.nc").write_text(text)
    assert programs.states_forces(tmp_path / "part.nc") == is_stated
    assert not programs.states_forces(tmp_path / "absent.nc")
