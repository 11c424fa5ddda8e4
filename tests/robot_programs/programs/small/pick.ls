/PROG  PICK
/ATTR
OWNER		= MNEDITOR;
/MN
   1:  UFRAME_NUM=1 ;
   2:  UTOOL_NUM=2 ;
   3:  !J P[9] 100% FINE ;
   4:J P[1] 100% FINE    ;
   5:L P[2:"at part"] 250mm/sec CNT50    ;
   6:  FOR R[1]=1 TO 10 ;
   7:L P[3] 250mm/sec FINE Offset,PR[4]    ;
   8:C P[4]    
    :  P[5] 250mm/sec FINE    ;
   9:  ENDFOR ;
  10:L PR[7] 100mm/sec FINE    ;
  11:J P[6] 20% FINE    ;
  12:L P[8] 20mm/sec FINE    ;
  13:  CALL SUB(1) ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    400.000  mm,	Y =  -12.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    10.000 deg
};
P[2:"at part"]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    410.125  mm,	Y =  -22.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    20.000 deg
};
P[3]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    420.000  mm,	Y =  -32.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    30.000 deg
};
P[4]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    430.000  mm,	Y =  -42.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    40.000 deg
};
P[5]{
   GP1:
	UF : 0, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    440.000  mm,	Y =  -52.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    50.000 deg
};
P[6]{
   GP1:
	UF : 1, UT : 2,	
	J1=    10.000 deg,	J2=   -20.000 deg,	J3=    30.000 deg,
	J4=     0.000 deg,	J5=   -60.000 deg,	J6=     5.000 deg
};
P[7]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =    1.000  mm,	Y =  -72.500  mm,	Z =   300.000  mm,
	W =  -179.900 deg,	P =      .500 deg,	R =    70.000 deg
};
P[8]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =  ********  mm,	Y =  ********  mm,	Z =  ********  mm,
	W =  ******** deg,	P =  ******** deg,	R =  ******** deg
};
/END
