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
    MoveAbsJ jHome\NoEOffs,v1000,fine,tGrip;
    FOR i FROM 1 TO 10 DO
      MoveJ p10,v500,z50,tGrip\WObj:=wobj0;
      MoveL p20,v100,fine,tGrip\WObj:=wFix; ! down
      MoveL Offs(p20,0,0,50),v100,fine,tGrip\WObj:=wFix;
      MoveL [[1.5,2.5,3.5],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;
      MoveC [[7,8,9],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],[[17,18,19],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,z10,tool0\WObj:=wFix;
    ENDFOR
    MoveL pBelt,v100,fine,tGrip\WObj:=wBelt;
    MoveL pTwo,v100,fine,tGrip;
    MoveL pTwo,v100,fine,tGrip\WObj:=wFix;
    MoveL pGrid{1},v100,fine,tGrip;
    Step;
  ENDPROC
  PROC Step()
    TPWrite "step 1; MoveL p10"; ! 1
  ENDPROC
ENDMODULE
