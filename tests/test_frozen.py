"""The frozen corpus: what differs is noticed, each kind apart."""

from tests.frozen import case as cases
from tests.frozen.case import Case
from tests.frozen.comparing import differences
from tests.frozen.running import run

PROGRAM = "DEF part( )\nLIN {X 1,Y 2,Z 3,A 0,B 0,C 180}\nEND\n"


def test_cases_come_back_from_their_file(tmp_path):
    given = Case("a", {"sub/x.src": b"DEF\r\n"}, (("postproc", "--help"),), {"0/exit": b"0\n"})
    assert cases.write(tmp_path / "g.zip", [given]) == 1
    assert cases.names(tmp_path / "g.zip") == ["a"]
    assert list(cases.read(tmp_path / "g.zip", ["a"])) == [given]


def test_a_command_is_run_in_the_folder_of_the_case_and_what_it_writes_is_kept():
    step = ("postproc", "convert", "part.src", "--cell", "gone.toml", "-o", "out")
    done = run(Case("a", {"part.src": PROGRAM.encode()}, (step,)))
    assert done.outputs["0/exit"] != b"0\n"
    assert b"gone.toml" in done.outputs["0/messages"]
    assert b"/frozen" not in done.outputs["0/messages"]


def test_each_kind_of_output_that_differs_is_named():
    before = {
        "0/exit": b"0\n",
        "0/messages": b"m\n",
        "files/a.csv": b"x\n1.0\n",
        "files/a.json": b"{}",
        "files/a.src": b"D",
    }
    after = {
        "0/exit": b"1\n",
        "0/messages": b"n\n",
        "files/a.csv": b"x\n1.5\n",
        "files/a.json": b"[]",
        "files/b.src": b"D",
    }
    found = {(one.output, one.kind) for one in differences("a", before, after)}
    assert found == {
        ("0/exit", "exit codes"),
        ("0/messages", "messages"),
        ("files/a.csv", "CSV"),
        ("files/a.json", "JSON"),
        ("files/a.src", "text"),
        ("files/b.src", "text"),
    }
    (csv,) = [one for one in differences("a", before, after) if one.kind == "CSV"]
    assert "numbers differ by up to 0.5" in csv.what
    assert list(differences("a", before, before)) == []


def test_sums_in_the_line_of_the_origin_do_not_count():
    line = ";POSTPROC 1 version=0.1.0 text={} model=3\nLIN"
    one, other = ({"files/a.src": line.format(n).encode()} for n in "ab")
    assert list(differences("a", one, other)) == []
    other["files/a.src"] += b" "
    assert len(list(differences("a", one, other))) == 1
