; T1 = end mill (6 mm)
G21 ; (mm)
G90
G0 Z10 ; safe (clear of clamps
G0 X0 Y0
G1 Z-1 F100
X10
M30
