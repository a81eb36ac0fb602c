"""Fields of a form for a TOML file, edits of its text, and the list of points to probe."""

from __future__ import annotations

import pytest
import tomlkit

from postproc.errors import InputError, PostprocError
from postproc.jobs import probing_list
from postproc.jobs.file_form import (
    FormField,
    changes_of_user,
    edit_text,
    fields_of_table,
    parse,
    table_schema,
    write_valid,
)

TEXT = """# the shop's cell
[base]   # on the table
X = 1500   # measured
Y = -200.5

[tools.1]
diameter_mm = 10.0
"""
X, Y, Z = (FormField("base", key, "number", text) for key, text in (("X", "1500"), ("Y", "-200.5"), ("Z", "")))


def edited(fields, text=TEXT, **texts):
    return edit_text(text, tomlkit.parse(text), fields, {f"base.{key}": value for key, value in texts.items()})


def test_an_edit_changes_its_line_alone():
    assert edited([X, Y, Z], X="1500 ", Y="-200.5") == TEXT
    assert edited([X, Y], X=" 1600 ") == TEXT.replace("1500", "1600")
    assert edited([X, Y], Y="12,25") == TEXT.replace("-200.5", "12.25")
    assert edited([X, Y], Y="") == TEXT.replace("Y = -200.5\n", "")
    assert "Z = 7\n" in edited([X, Y, Z], Z="7.0")


@pytest.mark.parametrize(
    ("text", "value"),
    [("999999999999999", 10**15 - 1), ("1e15", 1e15), ("-1e15", -1e15), ("0", 0), ("-3.0", -3), ("0.5", 0.5)],
)
def test_numbers_are_whole_where_they_are_exact(text, value):
    found = tomlkit.parse(edited([X], X=text)).unwrap()["base"]["X"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize("text", ["ten", "nan", "inf", "1 2", "1,2,3"])
def test_what_is_no_number_is_refused_with_its_field(text):
    with pytest.raises(InputError, match=r"base.X = .* is no number"):
        edited([X], X=text)


def test_a_span_has_two_numbers_a_flag_is_true_or_false_and_a_word_stays_text():
    fields = [FormField("base", key, kind, "") for key, kind in (("span", "span"), ("on", "flag"), ("word", "text"))]
    base = tomlkit.parse(edited(fields, span="0, 12.5", on="true", word="12")).unwrap()["base"]
    assert (base["span"], base["on"], base["word"]) == ([0, 12.5], True, "12")
    for text in ("1", "1,2,3", "1, ", ", 2"):
        with pytest.raises(InputError, match=r"base.span = .*two numbers are needed"):
            edited(fields, span=text)


def test_a_missing_required_value_is_refused_in_a_table_that_has_values():
    needed = FormField("tools.1", "teeth", "count", "", help="number of teeth", is_required=True)
    diameter = FormField("tools.1", "diameter_mm", "number", "10.0")
    document = tomlkit.parse(TEXT)
    with pytest.raises(InputError, match=r"tools.1.teeth is missing") as caught:
        edit_text(TEXT, document, [needed, diameter], {})
    assert "number of teeth" in str(caught.value)
    assert edit_text(TEXT, document, [needed, X], {}) == TEXT  # of another table
    emptied = edit_text(TEXT, tomlkit.parse(TEXT), [needed, diameter], {"tools.1.diameter_mm": " "})
    assert tomlkit.parse(emptied).unwrap().get("tools", {}) == {}


@pytest.mark.parametrize(
    ("text", "table"),
    [
        ("", "stock.box"), ("[stock]\n", "stock.box"), ("[stock.mesh]\nfile = 1\n", "stock.box"),
        ("stock = {}\n", "stock.box"), ("stock = { border_mm = 2 } # thin\n", "stock.box"),
        ("[stock]\nborder = 1\n", "stock.box"), ("[a]\nx = 1\n", "base"),
    ],
)  # fmt: skip
def test_a_table_that_a_file_lacks_is_added(text, table):
    field = FormField(table, "X", "span", "")
    new = edit_text(text, tomlkit.parse(text), [field], {field.name: "0, 100"})
    found = tomlkit.parse(new).unwrap()
    before = tomlkit.parse(text).unwrap()
    for key in table.split("."):
        found, before = found[key], before.get(key, {})
    assert found == {**before, "X": [0, 100]}


def test_fields_have_value_limits_and_help_of_the_schema():
    document = parse('[tool]\nX = 1.5\naxis = "+X"\n', "cell.toml", InputError)
    fields = {field.key: field for field in fields_of_table(document, "cell", "tool")}
    assert (fields["X"].text, fields["X"].kind, fields["Y"].text) == ("1.5", "number", "")
    assert (fields["axis"].kind, fields["axis"].text) == ("choice", "+X")
    assert set(fields["axis"].choices) >= {"+X", "-X", "+Z"}
    numbers = [*fields_of_table(document, "cell", "tool", "number")]
    assert {field.kind for field in numbers} == {"number"}
    assert {field.key for field in numbers} < set(fields)
    box = {field.key: field for field in fields_of_table(parse("", "", InputError), "process", "stock.box")}
    assert {box[axis].kind for axis in "XYZ"} == {"span"}
    assert all(box[axis].is_required for axis in "XYZ")
    assert [*fields_of_table(parse("tool = 3\n", "", InputError), "cell", "tool")] == []
    assert table_schema("process", "stock.box").help
    with pytest.raises(PostprocError, match=r"cell.toml"):
        parse("[tool\n", "cell.toml", InputError)


def test_only_what_the_user_changed_is_a_change():
    """Another program may have written the file since the form was opened."""
    fields = [X, Y]
    shown = {"base.X": "1500", "base.Y": "-200.5"}
    assert changes_of_user(fields, {"base.X": " 1500 ", "base.Y": "7"}, shown) == {"base.Y": "7"}
    assert changes_of_user(fields, {"base.X": "1600"}, {}) == {"base.X": "1600"}
    assert changes_of_user(fields, {"base.X": "1400"}, {"base.X": "1400"}) == {}
    assert changes_of_user(fields, {"base.X": " 1500"}, {"base.X": "1400"}) == {"base.X": " 1500"}  # both the same
    with pytest.raises(InputError, match=r"base.X was 1400 when you opened this page, and is now 1500") as caught:
        changes_of_user(fields, {"base.X": "1600"}, {"base.X": "1400"})
    assert "Save again to write 1600." in str(caught.value)
    with pytest.raises(InputError, match=r"base.X was not stated .* is now 1500") as caught:
        changes_of_user(fields, {"base.X": "1600"}, {"base.X": ""})
    with pytest.raises(InputError, match=r"Save again to remove it"):
        changes_of_user(fields, {"base.X": " "}, {"base.X": "1400"})


def test_a_text_that_is_refused_leaves_the_file(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text("old")

    def check(trial):
        assert trial.parent == tmp_path
        if trial.read_text() == "bad":
            raise InputError("no number", file=str(trial))

    with pytest.raises(InputError, match=r"^cell\.toml: no number"):
        write_valid(path, "bad", check)
    assert path.read_text() == "old"
    write_valid(path, "new µ", check)
    assert path.read_bytes() == "new µ".encode()
    assert [file.name for file in tmp_path.iterdir()] == ["cell.toml"]


def test_the_points_to_probe_are_the_rows_without_comments(tmp_path):
    path = tmp_path / "probing.csv"
    assert probing_list.probing_list(path) == probing_list.ProbingList((), ())
    path.write_bytes('\ufeff# by hand\nfeature,X\n\nF01.left,1.5\n#F02,3\n"F,03",2\n'.encode())
    found = probing_list.probing_list(path)
    assert found.columns == ("feature", "X")
    assert found.rows == (("F01.left", "1.5"), ("F,03", "2"))
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it cannot be read"):
        probing_list.probing_list(path)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="this is no probing file"):
        probing_list.check_probed(path)
