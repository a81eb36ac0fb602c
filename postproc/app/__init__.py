"""A window for those who do not type: pages of this machine that show a folder and run commands in it.

`server` answers requests of one browser on this machine, `access` says which requests it answers. `workspace` is the
folder, `runs` are the commands that run in it, `screens` the pages. Long work is the command line itself, as a process
of its own, so that the command shown is the one that ran, it can be stopped, and it outlives a window that is closed.
"""
