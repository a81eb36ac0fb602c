"""Posts for programs that make robot programs: they hand the moves to the command `postproc` and give its KRL back.

`kuka_compensated_post` is for FreeCAD, `KUKA_KRC4_compensated` for RoboDK; `postproc_host` is what they share. All
three run in the host's own Python, from 3.8 on: they import nothing of postproc and nothing that is not in the standard
library or the host, and they compute nothing. `install` copies them to where the host looks for them.
`robodk_station` runs in postproc's own Python: it asks RoboDK for a cell.
"""

from postproc.hosts.install import HOSTS, Host, install_post, remove_post

__all__ = ["HOSTS", "Host", "install_post", "remove_post"]
