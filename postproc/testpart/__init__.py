"""A robot model from a milled part: features are cut uncorrected and probed, and their deviations identify the robot.

`features` makes the program, `design` chooses features, `cut` predicts surfaces, `fit` fits model and forces.
"""
