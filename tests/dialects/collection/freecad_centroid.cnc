;Exported by FreeCAD
;Post Processor: centroid_post
;Begin preamble
G53 G00 G17
G21
;begin operation: Profile
M25
G0 Z15.0
G0 X0.0 Y0.0
G1 Z-1.0 F100.0
G1 X20.0 F300.0
M5
M25
G49 H0
M99
