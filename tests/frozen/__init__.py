"""A frozen corpus: inputs with everything that a version makes of them, to compare another version with.

    python -m tests.frozen freeze DIR [--seeds 100] [--only krl gcode …]     inputs and outputs of this version
    python -m tests.frozen compare DIR [--quick] [--only …]                  run the frozen inputs again, and compare
    python -m tests.frozen renew DIR [--only …]                              keep the inputs, replace the outputs

The inputs are stored too, so that generators and tests may change without changing what is compared. `freeze` writes
one zip file a group of cases; `compare` prints how many outputs differ by kind (exit code, messages, standard output,
text, JSON, CSV, pages) with the first lines that do, and ends with 1 if any does. `--quick` runs a share of each group
that takes about a minute in all. Pages are compared without the library that draws plots.

A group is a function of `tests.frozen.groups`, a way to run a case one of `tests.frozen.running`.
"""
