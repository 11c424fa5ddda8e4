# ruff: noqa: E501  (lines are as controllers write them)
"""What may stand in a program without being what it looks like: it is named with its line, and never guessed."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from in_process import refused
from programs import FOLDER, WHOLE, listed

from lmeasure.core import RobotError
from lmeasure.robot_programs.program import rewritten

ENDS = {"krl": "a.src", "rapid": "a.mod", "fanuc": "a.ls", "ur-script": "a.script", "csv": "a.csv", "robodk": "a.csv"}
P = "X 1,Y 2,Z 3,A 4,B 5,C 6"
KRL = "$BASE=$NULLFRAME\n$TOOL=$NULLFRAME\n"
R = "[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
U = "0.1,0.2,0.3,0,0,0"


def fanuc(body: str, positions: str) -> str:
    lines = "".join(f"{i}:{line} ;\n" for i, line in enumerate(body.split("|"), 1))
    return f"/PROG T\n/MN\n{lines}/POS\n{positions}/END\n"


def at(number: int, more: str = "", config: str = "'N U T, 0, 0, 0'", frames: str = "UF : 0, UT : 0") -> str:
    return f"P[{number}]{{\n GP1:\n {frames}, CONFIG : {config},\n X = 1 mm, Y = 2 mm, Z = 3 mm,\n W = 4 deg, P = 5 deg, R = 6 deg{more}\n}};\n"


CASES = [
    # strings and remarks that look like motions; case; tabs
    ("krl", KRL + f"PRINT(\"LIN {{{P}}}\") ; LIN {{{P}}}\n\tlin\t{{E6POS: x 1,y 2,z 3,a 4,b 5,c 6}}\n", ["LIN of line 4"], []),
    ("krl", KRL + f"LIN {{{P},E1 0.0}}\nLIN {{{P},E1 12.5}}\n", ["LIN of line 3"], ["line 4: E1 is at 12.5"]),
    ("krl", KRL + f"LIN {{{P}}}\nLIN {{{P},E1 12.5}}\n", [], ["external axes are not stated here, but are not 0 elsewhere", "E1 is at 12.5"]),
    ("krl", KRL + "PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0,E1 1500}\n", ["PTP of line 3"], []),
    ("krl", KRL + "LIN {X 1,Y 2,Z 3,A 4,B 5,C 6,X 7}\n", [], ["an aggregate with a field that is repeated or is not a number"]),
    ("krl", KRL + f"LIN {{{P.replace('2', '1e400')}}}\n", [], ["an impossible number for a robot: inf"]),
    ("krl", KRL + f"LIN {{{P},S 'B010',T 'B101'}}\n", ["LIN of line 3"], []),
    ("krl", KRL + f"LIN {{{P}\n", [], ["a.src:3: LIN: the aggregate has no closing bracket"]),
    ("krl", f"$BASE={{{P}}}\nLIN {{{P}}}\n", [], ["the frame $TOOL is not stated"]),
    ("krl", KRL + f"LIN {{{P}}}:{{Z 5}}\n", [], ["a computed target"]),
    ("krl", f"$TOOL=$NULLFRAME\n$BASE={{{P}}}:{{{P}}}\nLIN {{{P}}}\n", [], ["is not stated"]),
    ("krl", f"$TOOL=TOOL_DATA[1]\nTOOL_DATA[1]={{{P}}}\nTOOL_DATA[1]={{{P.replace('6', '7')}}}\n$BASE=$NULLFRAME\nLIN {{{P}}}\n", [], ["TOOL_DATA[1]: the frame is not a list of six numbers, or differs elsewhere", "the frame TOOL_DATA[1] is not stated"]),
    ("krl", KRL + f"LOOP\nIF $IN[1] THEN\n$BASE={{{P}}}\nEXIT\nENDIF\n$BASE=$NULLFRAME\nENDLOOP\nLIN {{{P}}}\n", ["LIN of line 10"], []),
    ("krl", KRL + f"GOTO on\nLIN {{{P}}}\non:\nLIN {{{P}}}\n", ["LIN of line 6"], ["a.src:4: LIN: has no joint solution"]),
    ("krl", KRL + f"E6POS XP1={{{P}}}\nE6POS XP1={{{P}}}\nLIN XP1\n", [], ["XP1: declared more than once"]),
    ("krl", f"DEF A( )\n{KRL}BAS(#INITMOV,0)\nLIN {{{P}}}\nEND\n", [], ["the frame $BASE is not stated"]),
    ("krl", KRL + f"SLIN {{{P}}} WITH $TOOL = TOOL_DATA[9]\n", [], ["the frame TOOL_DATA[9] is not stated"]),
    # frames that an inline form, another kinematic, a computed number or a function sets; a tool that stands still
    ("krl", KRL + f"BAS(#BASE,1)\nFDAT_ACT = {{TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}}\nBAS(#FRAMES)\nLIN {{{P}}}\n", ["LIN of line 6"], []),
    ("krl", KRL + f"FDAT_ACT = {{TOOL_NO 2,BASE_NO 0,IPO_FRAME #TCP}}\nLIN {{{P}}}\n", [], ["line 4: the robot holds the workpiece, and the tool is stationary"]),
    ("krl", KRL + f"FDAT_ACT.BASE_NO=2\nLIN {{{P}}}\n", [], ["the frame $BASE is not stated"]),
    ("krl", f"DECL FDAT FP1={{TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}}\nFP1.BASE_NO=3\nFDAT_ACT=FP1\nLIN {{{P}}}\n", [], ["the frame $BASE is not stated"]),
    ("krl", KRL + f"$IPO_MODE=#TCP\nLIN {{{P}}}\n$IPO_MODE=#BASE\nLIN {{{P}}}\n", ["LIN of line 6"], ["line 4: the robot holds the workpiece, and the tool is stationary"]),
    ("krl", KRL + f"BAS(#EX_BASE,1)\nLIN {{{P}}}\n", [], ["the frame $BASE changed in line 3 is not stated"]),
    ("krl", f"$TOOL=$NULLFRAME\nBASE_DATA[1]={{{P}}}\nBASE_DATA[I].Z=5\nBAS(#BASE,1)\nLIN {{{P}}}\n", [], ["the program sets its frame BASE_DATA[1] in a.src:3"]),
    ("krl", KRL + f"SWITCH N\nCASE 1\n$BASE={{{P}}}\nDEFAULT\n$BASE={{{P}}}\nENDSWITCH\nLIN {{{P}}}\n", [], ["$BASE of line 5 / $NULLFRAME, $BASE of line 7"]),
    ("krl", f"DEF A( )\n{KRL}OK=TURNED()\nLIN {{{P}}}\nEND\nDEFFCT BOOL TURNED()\n$BASE={{{P}}}\nRETURN TRUE\nENDFCT\n", ["LIN of line 5"], []),
    ("krl", f"DEF A( )\n{KRL}E6POS XP1={{{P}}}\nIF GONE(XP1) THEN\nLIN XP1\nENDIF\nEND\nDEFFCT BOOL GONE(XP :IN)\nLIN XP\nENDFCT\n", [], ["XP1: is an argument of GONE in a.src:5", "LIN XP: no declaration with values here"]),
    # of RAPID
    ("rapid", f'TPWrite "MoveL {R},v1,fine,tool0;"; ! MoveL {R},v1,fine,tool0;\nMOVEL {R},V1,FINE,TOOL0;', ["MOVEL of line 2"], []),
    ("rapid", f"MoveL\n  {R}\n  ,v1 , fine,\n  tool0\n  \\WObj:=wobj0;", ["MoveL of line 2"], []),
    ("rapid", f"CONST robtarget p:={R};\nMoveL RelTool(p,0,0,5),v1,fine,tool0;\nMoveL Offs(p,0,0,5),v1,fine,tool0;", [], ["MoveL RelTool(p,0,0,5): a computed target", "MoveL Offs(p,0,0,5)", "p: no motion uses it"]),
    ("rapid", f"CONST robtarget p:={R};\nMoveL p,v1,fine,tool0;\nArcL p,v1,sm,wd,\n fine,tool0\\WObj:=w;", [], ["p: is an argument of ArcL in a.mod:3"]),
    ("rapid", f"CONST robtarget p:={R};\nMoveL p,v1,fine,tool0;\nIF x>1 ArcL p,v1,sm,wd,fine,tool0;", [], ["p: is an argument of IF in a.mod:3"]),
    ("rapid", f"CONST robtarget p:={R};\nMoveLDO p,v1,fine,tool0,do1,1;", ["p"], []),
    ("rapid", f"CONST robtarget p:={R};\nSearchL di1,q,p,v1,tool0;", ["p"], []),
    ("rapid", f"CONST robtarget p:={R};\nSearchL di1,p,{R},v1,tool0;\nMoveL p,v1,fine,tool0;", ["SearchL of line 2"], ["p: is a search target in a.mod:2"]),
    ("rapid", f"CONST robtarget p:={R};\nMoveL p,v1,fine,tool0\\WObj:=w{{2}};", [], ["the frame w{ is not stated"]),
    ("rapid", f"CONST robtarget p:={R};\nCONST robtarget P:={R};\nMoveL p,v1,fine,tool0;", [], ["declared more than once"]),
    ("rapid", f"MODULE A\nLOCAL CONST robtarget p:={R};\nENDMODULE\nMODULE B\nPROC main()\nMoveL p,v1,fine,tool0;\nENDPROC\nENDMODULE", [], ["MoveL p: no declaration with values here", "p: no motion uses it"]),
    ("rapid", f"PDispSet x;\nMoveL {R},v1,fine,tool0;", [], ["a displacement may be active, by PDispSet in a.mod:1"]),
    ("rapid", f"MoveL {R.replace('[1,0,0,0]', '[0,0,0,0]', 1)},v1,fine,tool0;", [], ["a quaternion of length 0, not 1"]),
    ("rapid", f"MoveL {R.replace('[1,0,0,0]', '[0.9,0,0,0]', 1)},v1,fine,tool0;", [], ["a quaternion of length 0.9, not 1"]),
    ("rapid", f"MoveL {R.replace('9E9', '500', 1)},v1,fine,tool0;", [], ["an external axis is at 500"]),
    ("rapid", f"MoveL {R.replace('2', '-1E30')},v1,fine,tool0;", [], ["an impossible number for a robot: -1e+30"]),
    ("rapid", f"MoveL {R},v1,fine,tool0", [], ["the instruction has no end"]),
    ("rapid", f"PERS tooldata t:=[TRUE,[[0,0,5],[0,0,0,0]],[1,[0,0,0],[1,0,0,0],0,0,0]];\nMoveL {R},v1,fine,t;", [], ["no orientation", "the frame t is not stated"]),
    ("rapid", f"CONST robtarget p:={R};\nPROC Go(robtarget p)\nMoveL p,v1,fine,tool0;\nENDPROC", [], ["a.mod:3: MoveL p: no declaration with values here", "p: no motion uses it"]),
    ("rapid", f"CONST robtarget p:={R};\nPROC Go()\nVAR robtarget p;\np:=CRobT();\nMoveL p,v1,fine,tool0;\nENDPROC\nPROC On()\nMoveL p,v1,fine,tool0;\nENDPROC", ["p"], ["a.mod:5: MoveL p: no declaration with values here"]),
    ("rapid", f"PROC Go(PERS wobjdata wobj0)\nMoveL {R},v1,fine,tool0\\WObj:=wobj0;\nENDPROC", [], ["the frame wobj0 of line 2, an argument of its routine is not stated"]),
    ("rapid", f"VAR robtarget p:={R};\nTEST n\nCASE 1: p:=Offs(p,0,0,1);\nENDTEST\nMoveL p,v1,fine,tool0;", [], ["p: the program changes it in a.mod:3"]),
    ("rapid", f"VAR robtarget p:={R};\nTEST n\nCASE 1: Sub p;\nENDTEST\nMoveL p,v1,fine,tool0;", [], ["p: is an argument of Sub in a.mod:3"]),
    ("rapid", f"VAR robtarget p:={R};\n%\"Sub\"% p;\nMoveL p,v1,fine,tool0;", [], ["p: is an argument of %"]),
    ("rapid", f"VAR robtarget p:={R};\nFUNC bool Found(INOUT robtarget q)\nENDFUNC\nPROC main()\nok:=Found(p);\nMoveL p,v1,fine,tool0;\nENDPROC", [], ["p: is an argument of Found in a.mod:5"]),
    ("rapid", f"CONST robtarget p:={R};\nMoveL p,v1,fine,tool0\\Corr;", [], ["a.mod:2: MoveL with \\Corr: a sensor shifts the path"]),
    ("rapid", f"PERS tooldata tool1:=[TRUE,[[0,0,5],[1,0,0,0]],[1,[0,0,0],[1,0,0,0],0,0,0]];\ntool1.tframe.trans.z:=9;\nMoveL {R},v1,fine,tool1;", [], ["the program sets its frame tool1 in a.mod:2"]),
    # of FANUC
    ("fanuc", fanuc("L P[1] 1mm/sec FINE|!L P[2]|//L P[2] 1mm/sec FINE", at(1) + at(2)), ["P[1]"], ["P[2]: no motion uses it"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE Offset,PR[1]|L P[2] 1mm/sec FINE VOFFSET,VR[1]", at(1) + at(2)), [], ["P[1]: is a target of OFFSET", "P[2]: is a target of VOFFSET"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE|UFRAME[1]=PR[2]", at(1, frames="UF : 1, UT : 0")), [], ["the program sets its frame UF[1] in a.ls:4"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE", at(1, ",\n E1 = 7 mm")), [], ["P[1]: E1 is at 7"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE", at(1, config="'F L U T, 0, 0, 1'")), ["P[1]"], []),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE", at(1, config="'?'")), [], ["P[1]: a CONFIG of another kind"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE", at(1).replace("4 deg", "4 mm")), [], ["P[1]: W in mm"]),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE", at(1, ", X = 9 mm")), [], ["P[1]: X stated twice"]),
    ("fanuc", fanuc("L PR[1] 1mm/sec FINE|L P[R[1]] 1mm/sec FINE", at(1)), [], ["L PR[1]: a computed position", "P[1]: no motion uses it"]),
    ("fanuc", fanuc("S P[1] 1mm/sec FINE", at(1).replace("X = 1", "X = 99999999999")), [], ["an impossible number for a robot: 1e+11"]),
    ("fanuc", fanuc("L PAL_1[A_1] 100mm/sec FINE|L P[1] 1mm/sec FINE", at(1)), ["P[1]"], ["a.ls:3: L PAL_1[A_1]: a computed position"]),
    ("fanuc", fanuc("UFRAME[R[1]]=PR[2]|L P[1] 1mm/sec FINE", at(1, frames="UF : 1, UT : 0")), [], ["the program sets its frame UF[1] in a.ls:3"]),
    ("fanuc", fanuc("UTOOL[GP1:2]=PR[2]|L P[1] 1mm/sec FINE", at(1, frames="UF : 0, UT : 2")), [], ["the program sets its frame UT[2] in a.ls:3"]),
    ("fanuc", fanuc("UFRAME[R[1]]=PR[2]|L P[1] 1mm/sec FINE Skip,LBL[1],PR[4]=LPOS", at(1)), ["P[1]"], []),
    ("fanuc", fanuc("L P[1] 1mm/sec FINE Touch_Offset,PR[3]", at(1)), [], ["P[1]: is a target of TOUCH_OFFSET"]),
    # of scripts
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\ntextmsg('movel(p[{U}])') # movel(p[{U}])\nmovel(p[{U}])\n", ["movel of line 3"], []),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\nmovel(p[{U}] + p[0,0,1,0,0,0])\na=p[{U}]\nmovel(pose_add(a,p[0,0,1,0,0,0]))\n", [], ["movel of line 2: not six numbers", "movel pose_add", "a: no motion uses it"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\na = p[{U}] + p[0,0,1,0,0,0]\nmovel(a)\n", [], ["movel a: a target that is computed, or set elsewhere"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\nmovel(pose_trans(p[{U}],p[{U}]))\nmovel(pose_trans(w,p[{U}]))\n", [], ["movel pose_trans(p[", "the frame w is not stated"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\ndef f(a):\n movel(a)\nend\na=p[{U}]\nmovel(a)\n", [], ["movel a: a target that is computed, or set elsewhere"]),
    ("ur-script", f"def f():\n set_tcp(p[0,0,0,0,0,0])\n def g():\n  return 1\n end\n movel(p[{U}])\n return 0\n movel(p[{U}])\nend\n", ["movel of line 6"], ["a.script:8: movel p[", "has no joint solution"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\nwhile x:\n if y:\n  set_tcp(p[0,0,1,0,0,0])\n  break\n end\nend\nmovel(p[{U}])\n", [], ["used in several frames"]),
    ("ur-script", f"set_tcp(get_tcp())\nmovel(p[{U}])\nmovej([0,1,2,3,4])\nmovej([0,1,2,3,4,1e9])\n", [], ["the frame set_tcp of a.script:1 is not stated", "not six numbers", "an impossible number for a robot"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\nmovej(get_inverse_kin(p[{U}], get_actual_joint_positions()))\n", [], ["a target that is computed"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\na=p[{U}]\nmovej(get_inverse_kin(a,[0,0,0,0,0,0]))\nmovej(get_inverse_kin(a,[1,1,0,0,0,0]))\n", [], ["a: several joint solutions are stated"]),
    ("ur-script", f"set_tcp(pose=p[0,0,0,0,0,0])\nservoc(p[{U}],a=1)\nmovel(pose=p[{U}],a=1)\nmovej(q=[0,1,2,3,4,5])\n", ["servoc of line 2", "movel of line 3", "movej of line 4"], []),
    ("ur-script", f"def f():\n set_tcp(p[0,0,0,0,0,0])\n if x: set_tcp(p[0,0,1,0,0,0]) end\n movel(p[{U}])\nend\n", [], ["used in several frames"]),
    ("ur-script", f"set_tcp(p[0,0,0,0,0,0])\na=p[{U}]\ntrack_conveyor_linear(p[1,0,0,0,0,0],500)\nmovel(a)\nstop_conveyor_tracking()\nmovel(p[{U}])\n", ["movel of line 6"], ["movel a: is moved by track_conveyor_linear of line 3"]),
    # of tables
    ("csv", "sep=;\nname;x_mm;y_mm;z_mm;qx;qy;qz;qw\na;1;2;3;0;0;0;1\nb;1;2;3;0;0;0;2\n", ["a"], ["b: a quaternion of length 2, not 1"]),
    ("csv", "name,x_mm,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,1,1,2,3,0,0,0,1\n", [], ["a: two columns x_mm"]),
    ("csv", 'name,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,"1,234",2,3,0,0,0,1\nb,1_0,2,3,0,0,0,1\nc,inf,2,3,0,0,0,1\n', [], ["a: a cell is not a number", "b: a cell", "c: a cell"]),
    ("robodk", "Name,X [m],Y [mm],Z [mm],Rx [deg],Ry [deg],Rz [deg]\na,1,2,3,4,5,6\n", [], ["a: neither x, y, z"]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "targets", "said"), CASES)
def test_what_is_not_what_it_looks_like(name: str, text: str, targets: list[str], said: list[str]) -> None:
    dialect, listing = listed(name, ((ENDS[name], text),))
    listing = listing.stated({})
    assert [t.name for t in listing.targets] == targets
    lines = [str(u) for u in listing.unread]
    for part in said:
        assert any(part in line for line in lines), (part, lines)
    assert said or not lines, lines
    # what the user states of a frame does not help where the program sets it
    stated = dict.fromkeys(("BASE_DATA[1]", "UF[1]", "UT[2]", "tool1"), np.array([0.0, 0, 0, 0, 0, 0, 1]))
    assert "the program sets its frame" not in " ".join(said) or not listed(name, ((ENDS[name], text),))[1].stated(stated).targets
    for target in listing.targets:
        if not target.joints:
            assert np.isfinite(dialect.pose(target.values)).all()


def known(name: str, texts: dict[str, str]) -> list[tuple[object, ...]]:
    """Of each target all but where it stands."""
    _, listing = listed(name, tuple(texts.items()))
    of_line = re.compile(r" of line \d+| of [\w.]+:\d+|in [\w.]+:\d+")
    keys = [
        (of_line.sub("", t.name), t.joints, t.values, of_line.sub("", t.base), of_line.sub("", t.tool), tuple(t.flags.items()))
        for t in listing.targets
    ]
    return sorted(keys, key=lambda key: str(key).lower())


@pytest.mark.parametrize("name", sorted(WHOLE))
@pytest.mark.parametrize("change", ["ends", "blanks", "tabs", "mark", "case", "remarks"])
def test_how_a_program_is_written_down_does_not_matter(name: str, change: str) -> None:
    texts = {file: (FOLDER / file).read_bytes().decode("latin-1") for file in WHOLE[name]}
    plain = {file: text.replace("\r\n", "\n") for file, text in texts.items()}
    remark = {"krl": "; PTP XHOME", "rapid": "! MoveL pFirst", "fanuc": "", "ur-script": "# movej(home_q)"}.get(name, "# x_mm")
    made: dict[str, Callable[[str], str]] = {
        "ends": lambda t: t if "\r" in texts[WHOLE[name][0]] else t.replace("\n", "\r\n"),
        "blanks": lambda t: t.replace("\n", "  \n"),
        "tabs": lambda t: re.sub(r"(?m)^ +", lambda m: "\t" * len(m[0]), t),
        "mark": lambda t: "\xef\xbb\xbf" + t.removeprefix("\xef\xbb\xbf"),
        "case": lambda t: {"krl": t.lower(), "rapid": t.upper()}.get(name, t),
        "remarks": lambda t: t.replace("\n", f"\n{remark}\n") if remark else t,
    }
    # names are told as they are written: of RAPID in capitals here
    before, after = (str(known(name, each)) for each in (texts, {file: made[change](text) for file, text in plain.items()}))
    assert (after.lower(), len(after)) == (before.lower(), len(before))


NESTED = {"krl": ("LOOP\n", f"LIN {{{P}}}\n", "ENDLOOP\n"), "ur-script": ("while x:\n", f"movel(p[{U}])\n", "end\n")}


@pytest.mark.parametrize("name", NESTED)
def test_deeply_nested_programs_are_read_or_refused(name: str) -> None:
    begin, move, end = NESTED[name]
    _, listing = listed(name, ((ENDS[name], 60 * begin + move + 60 * end),))
    assert len(listing.targets) == 1
    with pytest.raises(RobotError, match="too deeply nested"):
        listed(name, ((ENDS[name], 5000 * begin + move),))


def test_numbers_of_thousands_of_digits_are_left() -> None:
    digits = "9" * 5000
    for name, text in (
        ("krl", f"BAS(#BASE,{digits})\n$BASE=BASE_DATA[{digits}]\n"),
        ("fanuc", fanuc(f"L P[{digits}] 1mm/sec FINE|L P[\xb2] FINE", "")),
    ):
        assert not listed(name, ((ENDS[name], text),))[1].targets


MARKS = list("[]{}()\"'!;#=,:*\n\r\t\0\\.-+") + ["E1 5", "\xff", "END", "ENDIF", "1e999", "PROC x()", "def f():", "/POS", "//"]


@settings(max_examples=120, deadline=None)
@given(st.sampled_from(sorted(WHOLE)), st.integers(0, 10**9))
def test_broken_bytes_never_end_in_a_fault_and_are_never_guessed(name: str, seed: int) -> None:
    """Cut off anywhere, with bytes lost, doubled and set in: what is still read has its numbers where it says, and goes back as it was."""
    rng = np.random.default_rng(seed)
    texts = {}
    for file in WHOLE[name]:
        signs = list((FOLDER / file).read_bytes().decode("latin-1"))
        first = int(rng.integers(0, len(signs))) if rng.random() < 0.5 else 0
        signs = signs[first : first + int(rng.integers(1, 6000))]
        for _ in range(int(rng.integers(0, 8))):
            place = int(rng.integers(0, len(signs)))
            signs[place] = str(rng.choice(MARKS)) if rng.random() < 0.7 else ""
        texts[ENDS[name] if len(WHOLE[name]) == 1 else file] = "".join(signs)
    try:
        dialect, listing = listed(name, tuple(texts.items()))
    except AssertionError:  # a table whose header is gone is of the other kind
        return
    assert rewritten(listing, dialect, {i: t.values for i, t in enumerate(listing.targets)}) == tuple(texts.values())
    assert all(u.line >= 1 and "\n" not in str(u) for u in listing.unread)
    for target in listing.stated({}).targets:
        text = listing.sources[target.source].text
        assert tuple(float(text[slice(*s)].replace(",", ".")) for s in target.spans) == target.values
        assert target.joints or np.isfinite(dialect.pose(target.values)).all()
    assert all(u.line >= 1 and "\n" not in str(u) for u in listing.unread)


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("a.src", b"", "a.src: no target that can be corrected as krl"),
        ("a.src", "DEF A( )\r\n".encode("utf-16"), "a.src: no text of a controller: it has NUL bytes"),
        ("a.ls", bytes(range(1, 256)) * 8, "a.ls: no target that can be corrected as fanuc"),
        ("a.mod", b"MODULE A\nMoveL [[1,2,3],[1,0,0,0]],v1,fine,tool0;", "The first omitted one: a.mod:2: MoveL of line 2: neither"),
        ("a.script", b"movel(" * 3000, "a.script: no target that can be corrected as ur-script"),
        ("a.csv", b"x_mm,y_mm,z_mm\n1,2,3\n", "The first omitted one: a.csv:2: row 1: neither"),
    ],
)
def test_a_file_without_a_target_is_one_line(tmp_path: Path, file: str, content: bytes, said: str) -> None:
    (tmp_path / file).write_bytes(content)
    (tmp_path / "map.csv").write_text(
        "x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm\n" + "".join(f"{i % 4},{i // 4 % 4},{i // 16},0,0,{i % 3}\n" for i in range(64))
    )
    (line,) = refused("correct", tmp_path / file, "--map", tmp_path / "map.csv", "--out", tmp_path / "o").splitlines()
    assert said in line
    assert not (tmp_path / "o").exists()
