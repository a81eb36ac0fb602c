$$ -----------------------------------------------------------------
$$     Generated on Saturday, November 21, 2026 10:15:00 AM
PARTNO PART OPERATION
PPRINT OPERATION NAME : Pocketing.1
CUTTER/ 10.000000,  0.000000
TOOLNO/1,   10.000000
LOADTL/1
FEDRAT/  300.0000,MMPM
SPINDL/ 1000.0000,RPM,CLW
RAPID
GOTO  /   10.00000,   20.00000,   30.00000
FINI
