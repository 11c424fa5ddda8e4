"""Targets that a program changes while it runs, or tells in several frames, are left as they are, with the reason."""

from pathlib import Path

import numpy as np
from programs import FANUC, listed

KRL_CHANGED = (Path(__file__).parent / "programs" / "small" / "changed.src").read_text(encoding="utf-8")
KRL_NAMES = "PLAIN", "SPLINED", "CHANGED", "GIVEN", "INSIDE", "BEHIND", "LOOPED", "CALLED", "AFTER", "TOOLED"
RAPID_LAST = "[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
RAPID_CHANGED = (
    "MODULE M\n"
    + "".join(f"VAR robtarget {n}:=[[1,2,{i}],{RAPID_LAST};\n" for i, n in enumerate(("pPlain", "pTaught", "pGiven", "pMoved")))
    + 'PERS wobjdata wA:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\nPROC main()\n  MoveL pPlain,v100,fine,tool0;\n'
    + "  IF x THEN pTaught.trans.z:=5; ENDIF\n  MoveL pTaught,v100,fine,tool0;\n  Sub pGiven,5;\n  MoveL pGiven,v100,fine,tool0;\n"
    + "  wA.uframe.trans.x:=350;\n  MoveL pMoved,v100,fine,tool0\\WObj:=wA;\nENDPROC\nENDMODULE\n"
)
FANUC_CHANGED = FANUC.replace(":J P[1] 100% FINE    ;\n", ":J P[1] 100% FINE    ;\n  99:  P[2]=P[1]    ;\n")
UR_CHANGED = (Path(__file__).parent / "programs" / "small" / "changed.script").read_text(encoding="utf-8")


def test_what_a_krl_program_changes_or_tells_in_several_frames_is_left() -> None:
    data = "DEFDAT MAIN\n" + "".join(f"DECL E6POS {n}={{X 1,Y 2,Z {i},A 0,B 0,C 0}}\n" for i, n in enumerate(KRL_NAMES)) + "ENDDAT\n"
    frames = {f"{kind}_DATA[{i}]": np.array([i, 0.0, 0, 0, 0, 0, 1]) for kind in ("BASE", "TOOL") for i in (1, 2, 3)}
    listing = listed("krl", (("main.src", KRL_CHANGED), ("main.dat", data)))[1].stated(frames)
    reported = {t.name: t.base for t in listing.targets}
    assert reported == {name: f"BASE_DATA[{i}]" for name, i in {"PLAIN": 1, "SPLINED": 1, "INSIDE": 2, "CALLED": 1, "AFTER": 3}.items()}
    said = [str(u) for u in listing.unread]
    for part in (
        "CHANGED: the program changes it in main.src:7",
        "GIVEN: is an argument of GIVE in main.src:9",
        "BEHIND: used in several frames: BASE_DATA[1] / TOOL_DATA[1], BASE_DATA[2] / TOOL_DATA[1]",
        "LOOPED: used in several frames",
        "TOOLED: the frame $TOOL changed in line 24 is not stated",
        "LIN P: no declaration with values here",
    ):
        assert any(part in line for line in said), (part, said)
    assert len(said) == 6


def test_what_a_rapid_program_changes_is_left() -> None:
    listing = listed("rapid", (("m.mod", RAPID_CHANGED),))[1].stated({})
    assert [t.name for t in listing.targets] == ["pPlain"]
    said = " ".join(str(u) for u in listing.unread)
    for part in (
        "pTaught: the program changes it in m.mod:9",
        "pGiven: is an argument of Sub in m.mod:11",
        "pMoved: the program sets its frame wa in m.mod",
    ):
        assert part in said, (part, said)
    displaced = RAPID_CHANGED.replace("PROC main()", "PROC main()\n  PDispSet shift;")
    assert not listed("rapid", (("m.mod", displaced),))[1].targets


def test_what_a_ur_program_changes_or_tells_with_several_tools_is_left() -> None:
    listing = listed("ur-script", (("m.script", UR_CHANGED),))[1].stated({})
    assert {t.name: t.tool.rpartition(":")[2] for t in listing.targets} == {"a_p": "5", "movel of line 16": "5"}
    said = " ".join(str(u) for u in listing.unread)
    assert "movel b_p: a target that is computed, or set elsewhere" in said
    assert "movel of line 13: used in several frames" in said


def test_what_a_fanuc_program_changes_is_left() -> None:
    listing = listed("fanuc", (("p.ls", FANUC_CHANGED),))[1]
    assert "P[2]" not in [t.name for t in listing.targets]
    assert any("P[2]: the program changes it in p.ls" in str(u) for u in listing.unread)
