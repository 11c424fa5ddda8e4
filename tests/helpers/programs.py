# ruff: noqa: E501  (lines are as controllers write them)
"""Small programs as controllers hold them, with what is to be left among what is a target; those of 200 lines are in programs/."""

from pathlib import Path

import numpy as np

from lmeasure.robot_programs import Dialect, Listing, Source, dialect_of

FOLDER = Path(__file__).parents[1] / "robot_programs" / "programs"
WHOLE = {
    "krl": ("tend.src", "tend.dat"),
    "rapid": ("Polish.mod",),
    "fanuc": ("DECK.LS",),
    "ur-script": ("palletise.script",),
    "csv": ("targets.csv",),
    "robodk": ("robodk.csv",),
}
KRL_DATA = """\
&ACCESS RVO
DEFDAT PICK PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS
EXT BAS (BAS_COMMAND :IN,REAL :IN)
;ENDFOLD
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}
DECL E6POS XP1={X 1000.5,Y -200.25,Z 800.125,A 180.0,B 0.5,C 179.9,S 2,T 10,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
DECL FDAT FP2={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " "}
DECL E6POS XP2={X 900,Y 100,Z 700,A -90,B 45.5,C 10,S 6,T 27,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
DECL E6AXIS XHOME={A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 45.0,A6 0.0,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}
E6POS TAUGHT={X 1.0E2,Y +20.5,Z -3.25,A 1,B 2,C 3}
E6POS UNUSED={X 1,Y 2,Z 3,A 1,B 2,C 3}
E6POS TWICE={X 500,Y 2,Z 3,A 1,B 2,C 3}
FRAME FIXTURE={X 100,Y 0,Z 50,A 30,B 0,C 0} ; of the fixture
BASE_DATA[2]={X 50.0,Y 60.0,Z 70.0,A 90.0,B 0.0,C 0.0}
TOOL_DATA[1]={X 0.0,Y 0.0,Z 120.0,A 0.0,B 0.0,C 0.0}
ENDDAT
"""

KRL_SOURCE = (
    """\
&ACCESS RVO
DEF PICK ( )
INT I ; LIN {X 9,Y 9,Z 9,A 9,B 9,C 9} is only a remark
;FOLD PTP P1 Vel=100 % PDAT1 Tool[1]:Gripper Base[2]:Fixture;%{PE}
$BWDSTART=FALSE
FDAT_ACT=FP1
BAS(#PTP_PARAMS,100)
PTP XP1
;ENDFOLD
FDAT_ACT=FP2
LIN XP2 C_DIS
PTP XHOME
$BASE=FIXTURE
$TOOL=TOOL_DATA[1]
LIN TAUGHT
FOR I=1 TO 10
  LIN {X 10.0,Y 20.0,Z 30.0,A 0.0,B 90.0,C 0.0} C_DIS
  LIN_REL {Z 10}
  IF I==3 THEN
    CIRC {X 1,Y 2,Z 3,A 4,B 5,C 6},{X 7.5,Y 8.5,Z 9.5,A 10,B 11,C 12},CA 180
  ENDIF
ENDFOR
$BASE={X 1,Y 2,Z 3,A 4,B 5,C 6}
LIN TWICE
$BASE=$NULLFRAME
LIN TWICE
LIN XP1:{X 0,Y 0,Z 50,A 0,B 0,C 0}
LIN {Z 100}
BAS(#BASE,7)
LIN {X 11,Y 12,Z 13,A 14,B 15,C 16}
SUB( )
END
DEF SUB( )
"""
    + "WAIT FOR $IN[1] ; step 1\nEND\n"
)

RAPID = (
    """\
MODULE Cell
  ! robtarget pRemark:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PERS tooldata tGrip:=[TRUE,[[0,0,120.5],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
  PERS wobjdata wFix:=[FALSE,TRUE,"",[[500,0,100],[0.707106781,0,0,0.707106781]],[[0,10,0],[1,0,0,0]]];
  PERS wobjdata wBelt:=[FALSE,FALSE,"CNV1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  CONST robtarget p10:=[[600.25,-100.5,400],[0,0,1,0],[0,-1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  LOCAL CONST robtarget p20:=[[10,20,30],[0.5,0.5,-0.5,0.5],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pBelt:=[[10,20,30],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pTwo:=[[10,20,31],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pFree:=[[1,1,1],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pGrid{2}:=[[[1,1,1],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],[[2,1,1],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]];
  CONST jointtarget jHome:=[[0,-20.5,30,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveAbsJ jHome\\NoEOffs,v1000,fine,tGrip;
    FOR i FROM 1 TO 10 DO
      MoveJ p10,v500,z50,tGrip\\WObj:=wobj0;
      MoveL p20,v100,fine,tGrip\\WObj:=wFix; ! down
      MoveL Offs(p20,0,0,50),v100,fine,tGrip\\WObj:=wFix;
      MoveL [[1.5,2.5,3.5],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
      MoveC [[7,8,9],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],[[17,18,19],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z10,tool0\\WObj:=wFix;
    ENDFOR
    MoveL pBelt,v100,fine,tGrip\\WObj:=wBelt;
    MoveL pTwo,v100,fine,tGrip;
    MoveL pTwo,v100,fine,tGrip\\WObj:=wFix;
    MoveL pGrid{1},v100,fine,tGrip;
    Step;
  ENDPROC
  PROC Step()
"""
    + '    TPWrite "step 1; MoveL p10"; ! 1\n'
    + "  ENDPROC\nENDMODULE\n"
)


def _fanuc() -> str:
    body = [
        "UFRAME_NUM=1 ;",
        "UTOOL_NUM=2 ;",
        "!J P[9] 100% FINE ;",
        "J P[1] 100% FINE    ;",
        'L P[2:"at part"] 250mm/sec CNT50    ;',
        "FOR R[1]=1 TO 10 ;",
        "L P[3] 250mm/sec FINE Offset,PR[4]    ;",
        "C P[4]    \n    :  P[5] 250mm/sec FINE    ;",
        "ENDFOR ;",
        "L PR[7] 100mm/sec FINE    ;",
        "J P[6] 20% FINE    ;",
        "L P[8] 20mm/sec FINE    ;",
        "CALL SUB(1) ;",
    ]
    lines = "".join(
        f"{i + 1:4d}:  {line}\n" if line[:2] not in ("J ", "L ", "C ") else f"{i + 1:4d}:{line}\n" for i, line in enumerate(body)
    )

    def cart(n: int, x: str, uf: str = "1", ut: str = "2", name: str = "") -> str:
        return (
            f"P[{n}{name}]{{\n   GP1:\n\tUF : {uf}, UT : {ut},\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {x}  mm,\tY =  -{n}2.500  mm,\tZ =   300.000  mm,\n"
            f"\tW =  -179.900 deg,\tP =      .500 deg,\tR =    {n}0.000 deg\n}};\n"
        )

    joint = "P[6]{\n   GP1:\n\tUF : 1, UT : 2,\t\n\tJ1=    10.000 deg,\tJ2=   -20.000 deg,\tJ3=    30.000 deg,\n\tJ4=     0.000 deg,\tJ5=   -60.000 deg,\tJ6=     5.000 deg\n};\n"
    untaught = "P[8]{\n   GP1:\n\tUF : 1, UT : 2,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX =  ********  mm,\tY =  ********  mm,\tZ =  ********  mm,\n\tW =  ******** deg,\tP =  ******** deg,\tR =  ******** deg\n};\n"
    positions = (
        cart(1, "   400.000")
        + cart(2, "   410.125", name=':"at part"')
        + cart(3, "   420.000")
        + cart(4, "   430.000")
        + cart(5, "   440.000", uf="0")
    )
    return f"/PROG  PICK\n/ATTR\nOWNER\t\t= MNEDITOR;\n/MN\n{lines}/POS\n{positions}{joint}{cart(7, '   1.000')}{untaught}/END\n"


FANUC = _fanuc()

UR = """\
def pick():
  # movel(p[9,9,9,9,9,9])
  set_tcp(p[0.0, 0.0, 0.1205, 0.0, 0.0, 0.0])
  global fixture = p[0.5, 0.1, 0.05, 0.0, 0.0, 1.570796]
  global at_part_p = p[0.4001, -0.2002, 0.3003, 3.14, 0.01, 0.02]
  global home_q = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]
  above_p = pose_add(at_part_p, p[0, 0, 0.05, 0, 0, 0])
  changed_p = p[1, 2, 3, 0, 0, 0]
  changed_p = p[1, 2, 4, 0, 0, 0]
  movej(home_q, a=1.4, v=1.05)
  i = 0
  while i < 10:
    movel(at_part_p, a=1.2, v=0.25)
    movel(above_p)
    movej([0.1, -1.2, 1.3, -1.4, -1.5, 0.6], r=0.01)
    movel(pose_trans(fixture, p[0.01, 0.02, 0.03, 0.1, 0.2, 0.3]), v=0.1)
    movec(p[0.1, 0.2, 0.3, 0, 0, 0], p[0.15, 0.25, 0.35, 0.0, 0.0, 0.7], a=1.2)
    movel(changed_p)
    i = i + 1
  end
  textmsg("movel(p[7,7,7,7,7,7])")
  set_tcp(p[0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
  movel(p[0.3, 0.2, 0.1, 0.0, 3.1, 0.0])
  movej(get_inverse_kin(above_p))
end
"""

ALL = {
    "krl": (("pick.src", KRL_SOURCE), ("pick.dat", KRL_DATA)),
    "rapid": (("cell.mod", RAPID),),
    "fanuc": (("pick.ls", FANUC),),
    "ur-script": (("pick.script", UR),),
}


def homogeneous(place: list[float], turn: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, place
    return out


def about(axis: int, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    out = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def listed(name: str, sources: tuple[tuple[str, str], ...] | None = None) -> tuple[Dialect, Listing]:
    """A program, one of these or of given names and texts, as its dialect reads it."""
    files = tuple(Source(n, t) for n, t in (sources or ALL[name]))
    dialect = dialect_of([Path(n) for n, _ in (sources or ALL[name])], files)
    assert dialect.name == name
    return dialect, dialect.read(files)
