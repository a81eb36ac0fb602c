"""Questions of the set-up: a stock that is a guess until somebody has checked it, and a tool frame for each tool."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import pytest

from postproc import cell as cells
from postproc.app.screens import posted_answers
from postproc.errors import InputError
from postproc.jobs.cell_edit import (
    edit,
    feed_rule,
    fields_of,
    frame_tables,
    missing_frames,
    robot_and_frames_text,
    set_feed_rule,
)
from postproc.jobs.program_needs import ProgramNeeds, needs_of
from postproc.jobs.setup_form import CHECKED_KEY, OFFERED_KEY, setup_form, start_arguments
from tests.app.test_window import looked_at, opened
from tests.commands import CELL_IN_NUMBERS, run
from tests.kr270 import CELL_TEXT
from tests.pages.browser import needs_chromium
from tests.places import CELL_FILE

PART = """G21 G90
{comment}
T1 M6
S9000 M3
G0 X0 Y0 Z5
G1 Z-2 F300
X50 F900
G0 Z20
M30
"""
TWO = PART.format(comment="(T1 D=10. CR=0. - flat end mill)").replace(
    "M30", "T5 M6\nG0 X9 Y9 Z5\nG1 Z-1 F99\nG0 Z9\nM30"
)
PROCESS = ["--material", "al_7075_hss", "--flutes", "3"]


@pytest.fixture
def program_file(tmp_path):
    path = tmp_path / "part.nc"
    path.write_text(PART.format(comment="(T1 D=10. CR=0. - flat end mill)"))
    return path


def stock_field(program_file, texts):
    form = setup_form(needs_of(program_file), texts, cell=False, process=True)
    (field,) = [field for field in form.fields if field.question.key == "stock"]
    return field, [text for text in start_arguments(program_file, form) if text.startswith("--stock")]


def test_a_stock_that_is_offered_is_an_answer_only_if_it_is_checked(program_file):
    field, options = stock_field(program_file, {})
    assert (field.is_guess, field.is_checked, options) == (True, False, [])
    guess = field.text
    field, options = stock_field(program_file, {"stock": guess, OFFERED_KEY: guess, CHECKED_KEY: "1"})
    assert (field.is_checked, options) == (True, [f"--stock={guess}"])
    field, options = stock_field(program_file, {"stock": "X=0:60,Y=-9:9,Z=-20:0", OFFERED_KEY: guess})
    assert (field.is_checked, options) == (True, ["--stock=X=0:60,Y=-9:9,Z=-20:0"])


def test_a_guess_for_another_diameter_does_not_count_as_stated(tmp_path):
    """The first form offers a box before the diameter is known: it is left as it is, and nobody has stated it."""
    program = tmp_path / "part.nc"
    program.write_text(PART.format(comment="(end mill)"))
    guess = stock_field(program, {})[0].text
    field, options = stock_field(program, {"cutter.1": "flat,20", "stock": guess, OFFERED_KEY: guess})
    assert field.text != guess
    assert (field.is_checked, options) == (False, [])


def test_the_place_of_a_stock_whose_size_comments_state_is_a_guess_too(tmp_path):
    program = tmp_path / "part.nc"
    size = "(T1 D=10. CR=0. - flat end mill)\n( Material Size)\n( X= 300.0, Y= 200.0, Z= 18.0)"
    program.write_text(PART.format(comment=size))
    field, options = stock_field(program, {})
    assert (field.text, field.is_guess, field.is_checked, options) == ("X=-125:175,Y=-100:100,Z=-18:0", True, False, [])
    done = run("start", program, *CELL_IN_NUMBERS, *PROCESS, "-o", tmp_path / "out")
    assert "The stock is assumed" in done.output


def test_the_fields_of_a_box_are_one_answer():
    form = {f"stock/{axis}/{end}": value for axis in "XYZ" for end, value in (("from", "-1"), ("to", " 2.5 "))}
    assert posted_answers(form)["stock"] == "X=-1:2.5,Y=-1:2.5,Z=-1:2.5"
    assert posted_answers(dict.fromkeys(form, ""))["stock"] == ""


@pytest.mark.parametrize("is_stated", [False, True])
def test_a_stated_stock_is_not_assumed_even_if_it_is_the_one_that_is_offered(program_file, is_stated):
    guess = stock_field(program_file, {})[0].text
    output = program_file.parent / "out"
    stock = ["--stock", guess] if is_stated else []
    for _ in range(2):  # also with the answers of an earlier start
        done = run("start", program_file, *CELL_IN_NUMBERS, *PROCESS, *stock, "-o", output)
        assert ("The stock is assumed" in done.output) == (not is_stated)
        assert tomllib.loads((output / "part.process.toml").read_text())["stock"].get("assumed", False) == (
            not is_stated
        )
        stock = []


def test_tools_of_a_program_get_frames_of_their_own_in_the_cell(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_TEXT.split("[tools")[0])
    two, other = (ProgramNeeds(Path("two.nc"), "gcode", tools=tools) for tools in ((1, 5), (3,)))
    assert (missing_frames(path, two), missing_frames(path, other)) == (("tools.1", "tools.5"), ())
    assert (
        robot_and_frames_text(path, (1, 5))
        == "KUKA KR 270-2 (2000 series), $BASE X 1500 Y -200 Z 700, $TOOL X 0 Y 0 Z 350"
    )
    assert robot_and_frames_text(path, (5,)).endswith("$TOOL of T5 X 0 Y 0 Z 350")
    assert edit(path, {"tools.1.Z": "350", "tools.5.Z": "301.5"}, ("tools.1", "tools.5"))
    assert {name: tool.Z for name, tool in cells.load(path).tools.items()} == {"1": 350.0, "5": 301.5}
    assert [field.text for field in fields_of(path) if field.name == "tools.5.Z"] == ["301.5"]
    assert (missing_frames(path, two), missing_frames(path, other)) == ((), ("tools.3",))
    assert "$TOOL of T5 X 0 Y 0 Z 301.5" in robot_and_frames_text(path, (1, 5))


def test_the_rule_of_the_feed_is_written_into_the_cell_and_nothing_else(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_TEXT)
    assert feed_rule(path) == ""  # without a tolerance there is nothing to hold
    text = CELL_TEXT + "\n[part]\ntolerance_mm = 0.1\n"
    path.write_text(text)
    before = tomllib.loads(text)
    assert feed_rule(path) == "program"
    assert set_feed_rule(path, "hold")
    assert feed_rule(path) == "hold"
    after = tomllib.loads(path.read_text())
    assert after == {**before, "output": {**before.get("output", {}), "feed": "hold"}}
    assert not set_feed_rule(path, "hold")
    with pytest.raises(InputError):
        set_feed_rule(path, "fast")
    assert feed_rule(path) == "hold"


def test_frames_by_number_and_work_offsets_that_a_cell_lacks_are_named_and_can_be_given(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL_TEXT.split("[tools")[0] + "[base_data.8]\nX = 10\n")
    needs = ProgramNeeds(
        Path("p.src"), "krl", work_offsets=("G55", "G59.1"), frames=("base_data.8", "base_data.5", "tool_data.7")
    )
    assert missing_frames(path, needs) == ("work_offsets.G55", "work_offsets.G59.1", "base_data.5", "tool_data.7")
    tables = frame_tables(",".join([*missing_frames(path, needs), "part", "base_data.x", "tools.1.Z"]))
    assert tables == ("work_offsets.G55", "base_data.5", "tool_data.7")
    texts = {"work_offsets.G55.Y": "-40", "base_data.5.X": "1500", "base_data.5.Z": "700", "tool_data.7.Z": "412.5"}
    assert edit(path, texts, tables)
    cell = cells.load(path)
    assert (cell.work_offsets["G55"].Y, cell.base_data["5"].Z, cell.tool_data["7"].Z) == (-40.0, 700.0, 412.5)
    assert missing_frames(path, needs) == ("work_offsets.G59.1",)
    assert {field.table for field in fields_of(path)} >= {
        "base_data.8",
        "base_data.5",
        "tool_data.7",
        "work_offsets.G55",
    }
    path.write_text(f'config_dat = "$config.dat"\n{CELL_TEXT.split("[tools")[0]}')
    (tmp_path / "$config.dat").write_text("DEFDAT $CONFIG PUBLIC\nENDDAT\n")
    assert missing_frames(path, needs) == ("work_offsets.G55", "work_offsets.G59.1")


@needs_chromium
def test_a_program_with_two_tools_leads_to_a_frame_for_each(browser, window):
    (window.workspace.folder / "two.nc").write_text(TWO)
    window.workspace.results.mkdir()
    shutil.copy(CELL_FILE, window.workspace.cell)
    window.workspace.cell.write_text(CELL_TEXT.split("[tools")[0])
    with opened(browser, window) as page:
        page.get_by_role("link", name="two.nc", exact=True).click()
        page.get_by_text("$TOOL X 0 Y 0 Z 350").wait_for()
        looked_at(page, "15-kept-cell")
        page.get_by_role("link", name="Give them first.").click()
        page.locator("input[name='tools.1.Z']").fill("350")
        page.locator("input[name='tools.5.Z']").fill("280")
        looked_at(page, "16-tools")
        page.get_by_role("button", name="Save").click()
        page.get_by_text("Saved.").wait_for()
        page.go_back()
        page.go_back()
        page.reload()
        page.get_by_text("$TOOL of T5 X 0 Y 0 Z 280").wait_for()
        assert page.get_by_role("link", name="Give them first.").count() == 0
    assert cells.load(window.workspace.cell).tools["5"].Z == 280.0
