(Exported by FreeCAD)
(Post Processor: grbl_post)
(Output Time:2026-11-21 10:15:00.000000)
(Begin preamble)
G17 G90
G21
(Begin operation: Fixture)
(Path: Fixture)
G54
(Finish operation: Fixture)
(Begin operation: TC: Default Tool)
(Path: TC: Default Tool)
(Default Tool)
(Begin toolchange)
( M6 T1 )
M3 S8000
(Finish operation: TC: Default Tool)
(Begin operation: Pocket_Shape)
(Path: Pocket_Shape)
G0 Z5.000
G0 X12.500 Y10.000
G0 Z3.000
G1 X12.500 Y10.000 Z-2.000 F120.000
G1 X37.500 Y10.000 Z-2.000 F600.000
G3 X40.000 Y12.500 Z-2.000 I0.000 J2.500 F600.000
G1 X40.000 Y30.000 Z-2.000 F600.000
G0 Z5.000
(Finish operation: Pocket_Shape)
(Begin postamble)
M5
G17 G90
M2
