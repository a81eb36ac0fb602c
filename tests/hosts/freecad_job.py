"""Runs in FreeCAD: builds a part and a job, and posts it by FreeCAD's own machinery.

`freecadcmd freecad_job.py` with a file `settings.json` in the working folder: posts to run in turn (processor,
arguments, output file). Writes `result.json`: for each what the post returned,
or what it raised.
"""

import json
from pathlib import Path

import FreeCAD
import Part
from PathScripts import PathDrilling, PathJob, PathPocketShape, PathPost, PathProfile

settings = json.loads(Path("settings.json").read_text())


def build():
    document = FreeCAD.newDocument("bracket")
    block = document.addObject("Part::Box", "Block")
    block.Length, block.Width, block.Height = 100, 60, 20
    pocket = document.addObject("Part::Box", "PocketShape")
    pocket.Length, pocket.Width, pocket.Height = 50, 30, 10
    pocket.Placement.Base = FreeCAD.Vector(20, 15, 10)
    hole = document.addObject("Part::Cylinder", "Hole")
    hole.Radius, hole.Height = 3, 20
    hole.Placement.Base = FreeCAD.Vector(85, 30, 0)
    part = block
    for tool in (pocket, hole):
        cut = document.addObject("Part::Cut", "Cut")
        cut.Base, cut.Tool = part, tool
        part = cut
    document.recompute()
    job = PathJob.Create("Job", [part], None)
    body = job.Model.Group[0]
    faces = {f"Face{number}": face.BoundBox for number, face in enumerate(body.Shape.Faces, start=1)}
    floor = next(name for name, box in faces.items() if abs(box.ZMax - 10) < 1e-6 and box.ZLength < 1e-6)
    wall = next(name for name, box in faces.items() if abs(box.XMin - 82) < 1e-6)
    controller = job.Tools.Group[0]
    controller.Tool.Diameter = 6
    controller.HorizFeed, controller.VertFeed, controller.SpindleSpeed = "1200 mm/min", "300 mm/min", 12000
    profile = PathProfile.Create("Profile")
    pocketing = PathPocketShape.Create("Pocket")
    pocketing.Base = [(body, floor)]
    drilling = PathDrilling.Create("Drilling")
    drilling.Base = [(body, wall)]
    for operation in (profile, pocketing, drilling):
        operation.ToolController = controller
    document.recompute()
    return job


def post(job, run):
    job.Tools.Group[0].Tool.Flutes = run.get("flutes", 2)
    job.Tools.Group[0].Tool.ShapeName = run.get("tool", "endmill")
    if run.get("stock") == "cylinder":
        job.Stock.Proxy, cylinder = None, Part.makeCylinder(65, 22, FreeCAD.Vector(50, 30, -1))
        job.Stock.Shape = cylinder
    for name in run.get("inactive", ()):
        FreeCAD.ActiveDocument.getObjectsByLabel(name)[0].Active = False
    job.PostProcessor, job.PostProcessorArgs = run["processor"], run["arguments"]
    job.PostProcessorOutputFile = run["file"]
    command = PathPost.CommandPathPost()
    texts = []
    for objects in command.buildPostList(job):
        failed, text, _ = command.exportObjectsWith(objects, job)
        assert not failed
        texts.append(text)
    return texts


job = build()
results = []
for run in settings["runs"]:
    try:
        results.append({"texts": post(job, run)})
    except Exception as cause:
        results.append({"error": f"{type(cause).__name__}: {cause}"})
Path("result.json").write_text(json.dumps(results))
