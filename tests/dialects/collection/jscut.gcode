G21         ; Set units to mm
G90         ; Absolute positioning
G1 Z5.08 F2540      ; Move to clearance level

;
; Operation:    0
;
; Path 0
; Rapid to initial position
G1 X4.1275 Y7.3025 F2540
G1 Z0.0000
; plunge
G1 Z-3.1750 F127
; cut
G1 X4.1275 Y17.3025 F1016
G1 X14.1275 Y17.3025
; Retract
G1 Z5.0800 F2540
M2
