(Fräsbahn für Größe 5 – Süd)
G21 G90
G0 X0 Y0 Z5
G1 Z-1 F100 (Vorschub 100 mm/min µ)
X10
M30
