(1001)
(Machine)
(  vendor: Autodesk)
(  model: Generic 3-axis Router)
(T1  D=6 CR=0 - ZMIN=-5 - flat end mill)
G90 G94
G17
G21
(When using Fusion for Personal Use, the feedrate of rapid)
(moves is reduced to match the feedrate of cutting moves,)
G53 G0 Z0

(Adaptive1)
T1
S10000 M3
G54
M8
G0 X34.482 Y12.5
Z15
G1 Z5 F1000
G1 Z0.6 F333.3
X34.4 Y12.493 Z0.544
G2 X34.3 Y12.6 Z0.4 I0 J0.107
G3 X33.9 Y12.2 I-0.4 J0 F1000
G1 X20
Y30
G3 X15 Y35 I-5 J0
G1 X10 Z-5
G0 Z15
G53 G0 Z0
M9
M5
G53 G0 X0 Y0
M30
