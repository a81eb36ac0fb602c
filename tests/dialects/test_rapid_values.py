"""Values of RAPID one by one, as the manual states them: operators, functions, records, speeds, zones and targets."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.dialects.rapid.syntax import modules
from postproc.dialects.rapid.values import (
    Scope,
    UnknownValueError,
    Variable,
    assign,
    evaluate,
    number,
    predefined_data,
    record_numbers,
    truth,
)
from postproc.errors import PostprocError
from tests.dialects.rapid_reading import AXES, at, correct_module, module, read, tail

TARGET = [[10.0, 20.0, 30.0], [0.5, 0.5, 0.5, 0.5], [0.0, -1.0, 1.0, 0.0], [9e9] * 6]


def scope():
    made = Scope({name: Variable(type_, value) for name, (value, type_) in predefined_data().items()})
    made.inner = {
        "N": Variable("NUM", [5.0, 6.0, 7.0]), "M": Variable("NUM", [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        "P": Variable("ROBTARGET", TARGET), "V": Variable("POS", [1.0, 2.0, 3.0]), "K": Variable("NUM", 2.0),
        "B": Variable("BOOL", value=True), "S": Variable("STRING", "ab"), "U": Variable("NUM", None, "it is read"),
    }  # fmt: skip
    return made


def parsed(text):
    return modules(f"MODULE m VAR num x:={text}; ENDMODULE")[0].data[0].value


def value_of(text):
    return evaluate(parsed(text), scope())


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2>1", True), ("1>1", False), ("1>2", False), ("1<2", True), ("1<1", False), ("2<1", False),
        ("1>=1", True), ("2>=1", True), ("1>=2", False), ("1<=1", True), ("1<=2", True), ("2<=1", False),
        ("1=1", True), ("1=2", False), ("1<>2", True), ("1<>1", False), ('S="ab"', True), ('S<>"ab"', False),
        ("B=TRUE", True), ("V=[1,2,3]", True), ("V<>[1,2,4]", True), ("NOT B", False), ("NOT FALSE", True),
        ("TRUE AND FALSE", False), ("TRUE AND TRUE", True), ("TRUE OR FALSE", True), ("FALSE OR FALSE", False),
        ("TRUE XOR FALSE", True), ("FALSE XOR FALSE", False), ("1+2=3 AND 2*2=4", True),
    ],
)  # fmt: skip
def test_conditions(text, value):
    assert value_of(text) == (value, "BOOL")
    assert truth(parsed(text), scope()) is value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7+2", 9), ("7-2", 5), ("7*2", 14), ("7/2", 3.5), ("7 DIV 2", 3), ("-7 DIV 2", -3), ("7 MOD 4", 3),
        ("-7 MOD 4", -3), ("7.5 MOD 2", 1.5), ("-K", -2), ("+K", 2), ("2-3-4", -5), ("16/4/2", 2),
        ("2+3*4-6/2", 11), ("(2+3)*(4-6)", -10), ("N{1}", 5), ("N{K+1}", 7), ("M{3,1}", 5), ("M{1,2}", 2),
        ("P.trans.y", 20), ("P.rot.q4", 0.5), ("P.robconf.cf4", -1), ("P.robconf.cf6", 1), ("P.extax.eax_f", 9e9),
        ("V.z", 3), ("Abs(-3.5)", 3.5), ("Sqrt(16)", 4), ("Pow(2,3)", 8), ("Sin(30)", 0.5), ("Cos(60)", 0.5),
        ("Tan(45)", 1), ("ASin(0.5)", 30), ("ACos(0.5)", 60), ("ATan(1)", 45), ("ATan2(1,-1)", 135), ("pi", math.pi),
        ("1E-1", 0.1), ("-.5E+1", -5), ("v100.v_tcp", 100), ("v100.v_ori", 500), ("z50.pzone_tcp", 50),
        ("z50.pzone_ori", 75), ("z50.zone_ori", 7.5), ("z50.zone_leax", 75), ("z0.pzone_tcp", 0.3), ("z1.pzone_ori", 1),
        ("vmax.v_tcp", 5000), ("tool0.tframe.rot.q1", 1), ("tool0.tload.mass", 0.001), ("wobj0.oframe.trans.x", 0),
    ],
)  # fmt: skip
def test_numbers(text, value):
    assert number(parsed(text), scope()) == pytest.approx(value, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("V+[1,1,1]", [2, 3, 4]), ("V-[1,1,1]", [0, 1, 2]), ("V*2", [2, 4, 6]), ("K*V", [2, 4, 6]),
        ("-V", [-1, -2, -3]),
        ("P.trans+V", [11, 22, 33]), ("M{2}", [3, 4]), ("fine.finep", True), ("z1.finep", False), ('S+"c"', "abc"),
        ("wobj0.robhold", False), ("tool0.robhold", True), ("Offs(P,1,-2,0.5)", [[11, 18, 30.5], *TARGET[1:]]),
    ],
)  # fmt: skip
def test_records_and_texts(text, value):
    assert value_of(text)[0] == value


@pytest.mark.parametrize(
    ("text", "type_"),
    [
        ("V+[1,1,1]", "POS"), ("[1,1,1]+V", "POS"), ("V*2", "POS"), ("-V", "POS"), ("K+1", "NUM"), ("[1,2,3]", ""),
        ("P.trans", "POS"), ("P.rot", "ORIENT"), ("P.robconf", "CONFDATA"), ("P.extax", "EXTJOINT"), ("V.x", "NUM"),
        ("wobj0.uframe", "POSE"), ("tool0.tload.cog", "POS"), ("tool0.tload.aom", "ORIENT"), ("M{1}", "NUM"),
        ("S", "STRING"), ("v5", "SPEEDDATA"), ("z5", "ZONEDATA"), ("load0", "LOADDATA"), ("pi", "NUM"),
    ],
)  # fmt: skip
def test_types(text, type_):
    assert value_of(text)[1] == type_


def test_predefined_speeds_and_zones_are_those_of_the_manual():
    """Data types speeddata and zonedata: of orientation and axes 1.5 times the radius, rounded up from z5 on."""
    names = [5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500, 2000, 2500, 3000, 4000]
    data = predefined_data()
    speeds = {name: value for name, (value, type_) in data.items() if type_ == "SPEEDDATA"}
    assert speeds == {f"V{name}": [float(name), 500.0, 5000.0, 1000.0] for name in [*names, 5000, 6000, 7000]} | {
        "VMAX": [5000.0, 500.0, 5000.0, 1000.0]
    }
    zones = {name: value for name, (value, type_) in data.items() if type_ == "ZONEDATA" and name != "FINE"}
    assert sorted(float(name[1:]) for name in zones) == [0, 1, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 150, 200]
    for name, (is_stop, tcp, *others) in zones.items():
        radius, turn = {"Z0": (0.3, 0.03), "Z1": (1.0, 0.1), "Z150": (225.0, 23.0)}.get(
            name, (math.floor(1.5 * tcp + 0.5), 0.1 * math.floor(1.5 * tcp + 0.5))
        )
        assert not is_stop
        assert tcp == (0.3 if name == "Z0" else float(name[1:]))
        assert others == pytest.approx([radius, radius, turn, radius, turn])


def test_all_stop_points_are_fine_and_have_no_zone():
    data = predefined_data()
    assert data["FINE"] == ([True, *[0.0] * 6], "ZONEDATA")
    for name, (value, type_) in data.items():
        if type_ == "ZONEDATA":
            assert value[0] == (name == "FINE")
    assert data["LOAD0"] == ([0.001, [0.0, 0.0, 0.001], [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0], "LOADDATA")
    assert data["TOOL0"] == ([True, [[0.0] * 3, [1.0, 0.0, 0.0, 0.0]], data["LOAD0"][0]], "TOOLDATA")
    assert data["V5000"][0] == [5000.0, 500.0, 5000.0, 1000.0]
    assert data["WOBJ0"][0] == [False, True, "", [[0.0] * 3, [1.0, 0.0, 0.0, 0.0]], [[0.0] * 3, [1.0, 0.0, 0.0, 0.0]]]


@pytest.mark.parametrize("options", ["", "\\Rx:=20", "\\Ry:=-30", "\\Rz:=40", "\\Rx:=20\\Ry:=-30\\Rz:=40"])
def test_reltool_moves_and_turns_in_the_tool(options):
    """Turned about x, then the new y, then the new z: by scipy."""
    (position, quaternion, *others), type_ = value_of(f"RelTool(P,1,2,3{options})")
    rotation = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])  # the same in either order
    np.testing.assert_allclose(position, np.array([10, 20, 30]) + rotation.apply([1.0, 2.0, 3.0]), atol=1e-12)
    angles = [
        float(found[1]) if (found := re.search(rf"{axis}:=(-?\d+)", options)) else 0.0 for axis in ("Rx", "Ry", "Rz")
    ]
    turned = rotation * Rotation.from_euler("XYZ", angles, degrees=True)
    np.testing.assert_allclose(
        Rotation.from_quat([*quaternion[1:], quaternion[0]]).as_matrix(), turned.as_matrix(), atol=1e-12
    )
    assert others == TARGET[2:]
    assert type_ == "ROBTARGET"


def test_orientzyx_turns_about_z_then_the_new_y_then_the_new_x():
    quaternion, type_ = value_of("OrientZYX(30,-20,50)")
    expected = Rotation.from_euler("ZYX", [30, -20, 50], degrees=True)
    found = Rotation.from_quat([*quaternion[1:], quaternion[0]])
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-12)
    assert type_ == "ORIENT"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("Q", "Q is not declared in this file"), ("U", "U is not known: it is read"),
        ("N{4}", "the index 4 is outside"),
        ("N{0}", "the index 0 is outside"), ("N{1.5}", "the index 1.5 is outside"), ("K{1}", "the index 1 is outside"),
        ("P.x", "the component X is not known"), ("V.trans", "the component TRANS is not known"),
        ("1/0", "cannot be calculated"), ("7 MOD 0", "cannot be calculated"), ("7 DIV 0", "cannot be calculated"),
        ("Pow(1E30,99)", "the call of POW is not understood"), ("Sqrt(-1)", "the call of SQRT is not understood"),
        ("Sqrt(TRUE)", "the call of SQRT is not understood"), ("Sin(1,2)", "the call of SIN is not understood"),
        ("Offs(P,1,2)", "the call of OFFS is not understood"), ("Offs(P,1,2,3\\Rx:=1)", "the call of OFFS is not"),
        ("RelTool(P,1,2)", "the call of RELTOOL is not"), ("RelTool(P,1,2,3\\Ra:=1)", "the call of RELTOOL is not"),
        ("OrientZYX(1,2)", "the call of ORIENTZYX is not"), ("Offs(V,1,2,3)", "another form than its type"),
        ("CRobT()", "the function CROBT gives its value at run time"), ("1=TRUE", "values of different types"),
        ('S="a"+1', "a number is expected"), ("V<[1,2,4]", "values of different types"),
        ("B+1", "a number is expected"),
        ("V+[1,2]", "an operation on records is not followed"), ("V*V", "an operation on records is not followed"),
        ("V/2", "an operation on records is not followed"), ("2/V", "an operation on records is not followed"),
        ("0.1*3=0.3", "depends on the rounding of the controller"), ("1E6=1000001", "depends on the rounding"),
    ],
)  # fmt: skip
def test_values_that_are_not_known_say_why(text, problem):
    with pytest.raises(UnknownValueError, match=re.escape(problem)):
        value_of(text)


@pytest.mark.parametrize(("text", "is_decided"), [("1E6=1000011", True), ("0.5=0.5", True), ("K=N{1}-3", True),
                                                  ("0.3=0.3", False), ("1E6<1000009", False)])  # fmt: skip
def test_comparisons_hold_where_single_precision_decides_them_too(text, is_decided):
    """From a difference of a hundred-thousandth on, or if both are the same number of single precision."""
    if is_decided:
        assert isinstance(value_of(text)[0], bool)
    else:
        with pytest.raises(UnknownValueError, match="rounding"):
            value_of(text)


def test_numbers_and_conditions_are_not_exchanged():
    with pytest.raises(UnknownValueError, match="a number is expected"):
        number(parsed("B"), scope())
    with pytest.raises(UnknownValueError, match="a number is expected"):
        number(parsed("S"), scope())
    with pytest.raises(UnknownValueError, match="a condition is expected"):
        truth(parsed("K"), scope())
    with pytest.raises(UnknownValueError, match="another form"):
        record_numbers([1.0, [2.0, 3.0]], 1, 3)
    with pytest.raises(UnknownValueError, match="a number is expected"):
        record_numbers([1.0, ["a"]], 1, 1)
    with pytest.raises(UnknownValueError, match="too large"):
        record_numbers([math.inf], 1)


@pytest.mark.parametrize(
    ("target", "value", "name", "expected"),
    [
        ("K", "3", "K", 3.0), ("N{2}", "9", "N", [5.0, 9.0, 7.0]), ("M{3,2}", "9", "M", [[1, 2], [3, 4], [5, 9]]),
        ("P.trans.y", "9", "P", [[10, 9, 30], *TARGET[1:]]),
        ("P.rot", "[1,0,0,0]", "P", [TARGET[0], [1, 0, 0, 0], *TARGET[2:]]),
        ("M{1}", "[8,9]", "M", [[8, 9], [3, 4], [5, 6]]),
    ],
)  # fmt: skip
def test_data_elements_and_components_take_values(target, value, name, expected):
    made = scope()
    assign(parsed(target), evaluate(parsed(value), made)[0], made)
    assert made.inner[name].value == expected
    assert TARGET[0] == [10.0, 20.0, 30.0]


@pytest.mark.parametrize(
    ("target", "problem"),
    [("N{4}", "outside of the array"), ("Q", "not declared"), ("N{0}", "outside"), ("N{1.5}", "outside")],
)
def test_a_place_that_there_is_not_takes_no_value(target, problem):
    with pytest.raises(UnknownValueError, match=problem):
        assign(parsed(target), 1.0, scope())


def test_data_that_a_trap_may_change_are_forgotten_instead():
    made = scope()
    made.inner["K"].interrupt = "the trap T"
    assign(parsed("K"), 5.0, made)
    with pytest.raises(UnknownValueError, match="K is not known: the trap T may change it"):
        evaluate(parsed("K"), made)


def heights(code, data="", routines=""):
    """Z [mm] of all moves behind the first."""
    return (read(module(code, data, routines)).motions.target[1:, 2, 3] * 1e3).round(6).tolist()


def moves(*zs):
    return [f"MoveL {at(0, 0, z)}{tail()}" for z in zs]


def move(height):
    return f"MoveL [[0,0,{height}],[0,1,0,0],[0,0,0,0],{AXES}]{tail()}"


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (["x:=20;", "Incr x;", move("x")], [21]), (["x:=20;", "Decr x;", move("x")], [19]),
        (["x:=20;", "Add x,5;", move("x")], [25]), (["x:=20;", "Add x,-5;", move("x")], [15]),
        (["x:=20;", "Clear x;", move("x+9")], [9]), ([move("x+9")], [9]),  # num is 0 where no value is declared
        (["IF b x:=5;", move("x+9")], [9]), (["b:=TRUE;", "IF b x:=5;", move("x+9")], [14]),
        (['IF s="" x:=5;', move("x+9")], [14]),
    ],
)  # fmt: skip
def test_counters_and_data_without_an_initial_value(code, expected):
    assert heights(code, "  VAR num x;\n  VAR bool b;\n  VAR string s;") == expected


@pytest.mark.parametrize("type_", ["pos p", "pos x{3}"])
def test_records_and_arrays_without_an_initial_value_are_not_known(type_):
    name = type_.split()[1].partition("{")[0]
    used = "p.z" if name == "p" else "x{2}.z"
    with pytest.raises(PostprocError, match="has no value yet"):
        heights([move(used)], f"  VAR {type_};")


@pytest.mark.parametrize(
    ("loop", "expected"),
    [
        ("FOR i FROM 1 TO 3 DO", [11, 12, 13]), ("FOR i FROM 3 TO 1 STEP -1 DO", [13, 12, 11]),
        ("FOR i FROM 1 TO 6 STEP 2 DO", [11, 13, 15]), ("FOR i FROM 2 TO 2 DO", [12]),
        ("FOR i FROM 3 TO 1 DO", [13, 12, 11]),
    ],
)  # fmt: skip
def test_rounds_of_for(loop, expected):
    """Without STEP it counts towards its end."""
    assert heights([loop, move("10+i"), "ENDFOR", *moves(50)]) == [*expected, 50]


def test_while_runs_as_long_as_its_condition_holds():
    code = ["x:=3;", "WHILE x>0 DO", move("10+x"), "Decr x;", "ENDWHILE", *moves(50)]
    assert heights(code, "  VAR num x;") == [13, 12, 11, 50]


@pytest.mark.parametrize(("value", "expected"), [(1, 11), (2, 12), (3, 12), (4, 19)])
def test_test_takes_the_case_of_its_value(value, expected):
    code = [f"x:={value};", "TEST x", "CASE 1:", *moves(11), "CASE 2,3:", *moves(12), "DEFAULT:", *moves(19), "ENDTEST"]
    assert heights(code, "  VAR num x;") == [expected]


@pytest.mark.parametrize(("value", "expected"), [(1, 11), (2, 12), (3, 19)])
def test_if_takes_the_first_branch_that_holds(value, expected):
    code = [f"x:={value};", "IF x=1 THEN", *moves(11), "ELSEIF x<=2 THEN", *moves(12), "ELSE", *moves(19), "ENDIF"]
    assert heights(code, "  VAR num x;") == [expected]


def speed_and_zone(text, head=()):
    motions = read(module([*head, f"MoveL {at(0, 0, 20)}{tail()}", text])).motions
    return float(motions.feed[-1]) * 1e3, float(motions.blend[-1]) * 1e3


@pytest.mark.parametrize(
    ("options", "feed", "zone"),
    [
        ("v50,z10", 50, 10), ("v50\\V:=30,z10", 30, 10), ("v50\\T:=2,z10", 30, 10), ("v50,fine", 50, 0),
        ("v50,z10\\Z:=4", 50, 4), ("v50,z10\\Z:=0", 50, 0), ("v50,z10\\Inpos:=inpos50", 50, 0),
        ("[12.5,500,5000,1000],[FALSE,3,4,4,0.5,4,0.5]", 12.5, 3), ("v50,[TRUE,3,4,4,0.5,4,0.5]", 50, 0),
        ("vmax,z200", 5000, 200),
    ],
)  # fmt: skip
def test_speeds_and_zones_of_moves(options, feed, zone):
    """The move is 60 mm long."""
    found = speed_and_zone(f"MoveL {at(60, 0, 20)},{options},tMill\\WObj:=wPart;")
    assert found == pytest.approx((feed, zone))


@pytest.mark.parametrize(
    ("velset", "options", "feed"),
    [("VelSet 50,800;", "v50", 25), ("VelSet 100,20;", "v50", 20), ("VelSet 50,800;", "v50\\V:=30", 15),
     ("VelSet 50,800;", "v50\\T:=2", 15), ("VelSet 100,20;", "v50\\V:=30", 20)],
)  # fmt: skip
def test_velset_lowers_and_limits_speeds(velset, options, feed):
    assert speed_and_zone(f"MoveL {at(60, 0, 20)},{options},z1,tMill\\WObj:=wPart;", [velset])[0] == pytest.approx(feed)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("v50\\V:=0,z1", "must be more than 0"), ("v50\\T:=-1,z1", "must be more than 0"), ("z1,z1", "no speeddata"),
        ("[0,500,5000,1000],z1", "the speed of the TCP must be more than 0"), ("v50,v50", "the zone is no zonedata"),
        ("v50,[FALSE,-1,4,4,0.5,4,0.5]", "the zone is no distance"),
    ],
)  # fmt: skip
def test_speeds_and_zones_that_are_none_are_refused(text, problem):
    with pytest.raises(PostprocError, match=problem):
        speed_and_zone(f"MoveL {at(60, 0, 20)},{text},tMill\\WObj:=wPart;")


def test_joint_and_robot_targets_are_not_exchanged():
    joints = f"[[0,10,20,0,60,0],{AXES}]"
    for text, data, problem in (
        (f"MoveAbsJ {at(0, 0, 20)}{tail()}", "", "MoveAbsJ goes to joint angles"),
        (f"MoveL j{tail()}", f"  CONST jointtarget j:={joints};", "a jointtarget is no target of this move"),
        (f"MoveAbsJ p{tail()}", f"  CONST robtarget p:={at(0, 0, 20)};", "a robtarget is no target of MoveAbsJ"),
        (f"MoveL {joints}{tail()}", "", "another form than its type"),
    ):  # fmt: skip
        with pytest.raises(PostprocError, match=problem):
            read(module([text], data))


def test_local_targets_hide_those_of_the_module_and_are_written_into_the_move(tmp_path):
    """Data of a routine have their own value. A name of two data is in both declarations as it was."""
    data = f"  CONST robtarget p:={at(0, 0, 30)};"
    code = ["! FORCE FX=300", f"MoveL p{tail()}", "Cut;"]
    routines = f"  PROC Cut()\n    VAR robtarget p:={at(60, 0, 20)};\n    MoveL p{tail()}\n  ENDPROC\n"
    assert heights(code, data, routines) == [30, 20]
    written = correct_module(tmp_path, module(code, data, routines))
    for kind, point in (("CONST", at(0, 0, 30)), ("VAR", at(60, 0, 20))):
        (line,) = [line for line in written.splitlines() if f"{kind} robtarget p" in line]
        assert point in line
    routine, _, main = written.partition("PROC Cut()")[2].partition("ENDPROC")
    assert "MoveL [[" in routine
    assert "MoveL [[" in main
    assert "MoveL p" not in written


def test_a_duration_stays_where_the_path_is_as_it_was(tmp_path):
    """Without a force nothing is corrected; the second move begins at a corrected end, the third does not."""
    code = [
        f"MoveL {at(0, 0, 20)}{tail()}", f"MoveL {at(60, 0, 20)},v50\\T:=2,z1,tMill\\WObj:=wPart;",
        "! FORCE FX=300", f"MoveL {at(60, 60, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;", "! FORCE OFF",
        f"MoveL {at(0, 60, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;",
        f"MoveL {at(0, 0, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;",
    ]  # fmt: skip
    written = [
        line.strip() for line in correct_module(tmp_path, module(code)).splitlines() if line.strip().startswith("MoveL")
    ]
    speeds = [re.search(r"v50(\\[TV]:=[\d.]+)?", line).group(1) for line in written]
    assert speeds[1] == "\\T:=2"
    assert speeds[-1] == "\\T:=2"
    assert set(speeds[2:-1]) == {"\\V:=30"}
