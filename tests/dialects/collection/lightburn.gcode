; LightBurn 1.4.00
; GRBL device profile, absolute coords
; Bounds: X10 Y10 to X30 Y30
G00 G17 G40 G21 G54
G90
M4
; Cut @ 1200 mm/min, 50% power
M8
G0 X10Y10
G1 X30S500F1200
G1 Y30
M9
G1S0
M5
G90
; return to user-defined finish pos
G0 X0Y0
M2
