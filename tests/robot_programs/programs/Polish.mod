%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE Polish
  ! polish of the left and right housings, taught with the long pad
  ! MoveL pEdge, v100, fine, tPad; was here before the second shift

  !***************************************************************
  ! Polishing of pump covers on two fixtures and a belt grinder.
  ! Positions pOld10, pOld20 were taken out; MoveL pOld10 is gone.
  !***************************************************************
  PERS tooldata tGrip:=[TRUE,[[12.5,-4,168.25],[0.99619470,0,0.08715574,0]],[4.2,[10,0,95],[1,0,0,0],0.01,0.01,0.02]];
  PERS tooldata tSpindle:=[TRUE,[[0,85.5,210],[0.70710678,0,0.70710678,0]],[6.5,[0,20,110],[1,0,0,0],0,0,0]];
  PERS tooldata tBelt:=[FALSE,[[1200,400,900],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata wLeft:=[FALSE,TRUE,"",[[700,420,350],[0.98480775,0,0,0.17364818]],[[25,-10,5],[1,0,0,0]]];
  TASK PERS wobjdata wRight:=[FALSE,TRUE,"",[[690.5,-455,352.25],[0.96592583,0,0,-0.25881905]],[[0,0,0],[0.99999048,0.00436331,0,0]]];
  PERS wobjdata wConv:=[FALSE,FALSE,"CNV1",[[0,900,300],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,50],[1,0,0,0]]];
  PERS wobjdata wFound:=[FALSE,TRUE,"",[[650,0,300],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  CONST jointtarget jHome:=[[0,-15,25,0,70,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST jointtarget jService:=[[-90,-30,60,0,60,15],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  CONST robtarget pAbove:=[[147.0775,46.9024,526.8030],[0.053036517,-0.979985522,0.106631596,-0.159515538],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pFirst:=[[213.2138,57.5179,346.5139],[0.034235875,-0.987975552,0.111184069,-0.101834746],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pSecond:=[[204.2822,169.2859,376.0607],[0.043247712,-0.988061918,0.093842268,-0.114266835],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pArc:=[[187.1981,107.9573,393.7069],[0.044045333,-0.985943449,0.102246625,-0.124583913],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  LOCAL CONST robtarget pRight{2}:=[[[224.3092,-123.5429,335.4881],[-0.076009239,0.666301733,0.150234403,0.726425646],[-1,-1,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],
                                    [[209.5266,-196.3436,336.1235],[-0.050566258,0.670917512,0.126913323,0.728838634],[-1,-1,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]]];
  CONST robtarget pEdge:=[[243.0317,-138.1593,337.3250],[-0.070356892,0.680159980,0.171856268,0.709152827],[-1,-1,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pTilted:=[[247.2320,-0.3104,361.0260],[0.244682754,-0.570775097,0.009666971,-0.783742744],[-1,-2,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PERS robtarget pTaught:=[[854.1079,154.6640,721.2378],[0.011376107,-0.987672115,-0.086410113,-0.130029498],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  VAR robtarget pFoundAt:=[[0,0,0],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pShared:=[[983.5758,4.0000,731.2814],[0.000000000,-0.996194698,0.000000000,-0.087155740],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pOnBelt:=[[100,0,20],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pRail:=[[900,0,700],[0,0,1,0],[0,0,0,0],[1500.5,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pBroken:=[[900,0,700],[0,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget pSpare:=[[900,10,700],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST speeddata vWork:=[120,90,1000,1000];
  CONST zonedata zWork:=[FALSE,2,3,3,0.3,3,0.3];
  PERS loaddata lCover:=[3.1,[0,0,40],[1,0,0,0],0,0,0];
  VAR num nDone:=0;
  VAR bool bReject:=FALSE;
  VAR intnum iStop;
  VAR triggdata tgAir;

  PROC main()
    Init;
    WHILE TRUE DO
      ! a cover each round: "MoveL pFirst" stands in the manual too
      WaitDI diCover,1\MaxTime:=30;
      TPWrite "cover "\Num:=nDone;
      PickLeft;
      IF bReject THEN
        Reject;
      ELSEIF nDone MOD 10 = 0 THEN
        Inspect;
      ELSE
        PolishRight;
      ENDIF
      nDone:=nDone+1;
      TEST nDone
      CASE 100,200:
        Dress;
      DEFAULT:
        WaitTime 0.1;
      ENDTEST
    ENDWHILE
  ERROR
    IF ERRNO=ERR_WAIT_MAXTIME THEN
      TPWrite "no cover for 30 s; see ""infeed"" !";
      RETRY;
    ENDIF
  ENDPROC

  LOCAL PROC Init()
    AccSet 80,80;
    ConfL\On;
    VelSet 100,2000;
    IDelete iStop;
    CONNECT iStop WITH tStop;
    ISignalDI diStop,1,iStop;
    TriggEquip tgAir,5,0.1\DOp:=doAir,1;
    MoveAbsJ jHome\NoEOffs,v1000,fine,tool0;
    MoveAbsJ [[5,-15,25,0,70,5],[9E9,9E9,9E9,9E9,9E9,9E9]]\NoEOffs,v500,z50,tGrip;
  ENDPROC

  PROC PickLeft()
    GripLoad load0;
    MoveJ pAbove,v1000,z50,tGrip\WObj:=wLeft;
    MoveL Offs(pFirst,0,0,30),v500,z5,tGrip\WObj:=wLeft;
    MoveL pFirst,v100,fine,tGrip\WObj:=wLeft\TLoad:=lCover;
    Set doGrip;
    WaitTime\InPos,0.3;
    MoveL RelTool(pFirst,0,0,-30\Rz:=15),v100,z1,tGrip\WObj:=wLeft;
    ! the other way round, through the arc
    MoveC pArc,pSecond,vWork,zWork,tGrip
      \WObj:=wLeft;
    movel pSecond, vWork\V:=80, z1\Z:=2,
      tGrip \WObj:=wLeft;
    MoveL [[175.2702,124.2343,439.3514],[0.051529517,-0.985092557,0.084052773,-0.140969836],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v200,z10,tGrip\WObj:=wLeft;
    MoveL pShared,v200,z10,tGrip;
    SearchL\Stop,diTouch,pFoundAt,pAbove,v20,tGrip\WObj:=wLeft;
    MoveL pFoundAt,v20,fine,tGrip\WObj:=wLeft;
  ENDPROC

  PROC PolishRight()
    VAR robtarget pLocal:=[[264.3730,-30.8500,337.6276],[-0.085258790,0.670188830,0.099422538,0.730542970],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    CONST robtarget pEdge:=[[266.8034,-50.0713,321.3553],[-0.079733057,0.677325413,0.092722853,0.725448411],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
    MoveJ pLocal,v500,z10,tSpindle\WObj:=wRight;
    TriggL pEdge,vWork,tgAir,z1,tSpindle\WObj:=wRight;
    FOR i FROM 1 TO 2 DO
      MoveL pRight{i},vWork,zWork,tSpindle\WObj:=wRight;
    ENDFOR
    MoveLDO pTilted,vWork,z1,tSpindle\WObj:=wRight,doAir,0;
    ArcLStart pShared,v100,seam1,weld1,fine,tGrip;
  ENDPROC

  PROC Inspect()
    ! the edge of the module here, that of PolishRight there
    MoveL pEdge,vWork,fine,tSpindle\WObj:=wRight;
    Touch pTaught,25;
    pTaught:=CRobT(\Tool:=tGrip\WObj:=wobj0);
    MoveL pTaught,v100,fine,tGrip;
    wFound.oframe.trans:=[nDone,0,0];
    MoveL [[10,20,30],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tGrip\WObj:=wFound;
    MoveL pOnBelt,v100,fine,tGrip\WObj:=wConv;
    MoveL [[0,0,20],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tBelt\WObj:=wHeld;
    MoveJ pRail,v1000,z100,tool0;
    MoveJ pBroken,v1000,z100,tool0;
    IF nDone>5 MoveJ [[828.6081,222.0249,960.1358],[0.008147126,-0.999048361,-0.026161002,-0.033935221],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1000,z50,tool0;
  ENDPROC

  PROC Dress()
    <SMT>
    MoveAbsJ jService\NoEOffs,v200,fine,tSpindle;
    MoveAbsJ CalcJointT(pAbove,tGrip\WObj:=wLeft),v200,fine,tGrip;
  ENDPROC

  PROC Reject()
    MoveJ [[548.6346,-814.5287,671.2498],[0.013998189,-0.966866875,0.158013983,-0.200010194],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1000,z100,tGrip;
    MoveL [[525.0371,-850.9339,556.8626],[0.026066236,-0.965385620,0.188299590,-0.178590090],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tGrip\WObj:=wobj0;
    Reset doGrip;
    bReject:=FALSE;
    RETURN;
  ENDPROC

  PROC Touch(robtarget pAt,num nForce)
    MoveL pAt,v50,fine,tGrip;
    IF nForce>20 THEN
      TPWrite "hard";
    ENDIF
  ENDPROC

  PROC Pattern(num nRows)
    ! a row of dimples over the cover, every one computed from pFirst
    VAR num nStep:=12.5;
    VAR pose peShift;
    FOR iRow FROM 0 TO nRows-1 DO
      FOR iCol FROM 0 TO 3 DO
        MoveL Offs(pFirst,iCol*nStep,iRow*nStep,10),v200,z5,tGrip\WObj:=wLeft;
        MoveL Offs(pFirst,iCol*nStep,iRow*nStep,0),v50,fine,tGrip\WObj:=wLeft;
        IF Depth(iCol,iRow)>3 THEN
          GOTO skipped;
        ENDIF
        PulseDO\PLength:=0.2,doPunch;
        skipped:
      ENDFOR
    ENDFOR
    peShift:=DefFrame(pAbove,pFirst,pSecond);
  ENDPROC

  PROC rWeigh()
    ! a scale that stands in the cell: nothing moves to its tray but this
    MoveJ [[493.6883,816.6288,723.2814],[-0.005168439,0.966723605,0.171536587,0.189720735],[0,-1,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,z20,tGrip;
    MoveL [[507.1332,849.4779,582.5508],[0.017532642,0.968737987,0.185856483,0.163391210],[0,-1,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tGrip;
    WaitTime 1;
    TEST nDone
    CASE 1:
      TPWrite "first";
    CASE 2,3:
      TPWrite "next";
    DEFAULT:
      Incr nDone;
      Decr nDone;
    ENDTEST
    MoveL [[493.6883,816.6288,723.2814],[-0.005168439,0.966723605,0.171536587,0.189720735],[0,-1,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,z20,tGrip;
  ENDPROC

  FUNC num Depth(num a,num b)
    RETURN Sqrt(a*a+b*b);
  ENDFUNC

  TRAP tStop
    StopMove;
    StorePath;
    MoveL pAbove,v50,fine,tGrip\WObj:=wLeft;
    RestoPath;
    StartMove;
  ENDTRAP
ENDMODULE
