"""Pinocchio as the authority: a robot model folder and what may be added to it, built by Pinocchio alone."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
KINDS = {
    "X": pin.JointModelPX, "Y": pin.JointModelPY, "Z": pin.JointModelPZ,
    "RX": pin.JointModelRX, "RY": pin.JointModelRY, "RZ": pin.JointModelRZ,
}  # fmt: skip


class Arm:
    """Joints in series and a flange.

    `displace`: joint or "flange" → (x, y, z [m], rotation vector [rad]); `springs`: (link, axis) in chain order;
    `heavier`: factors of the masses of the six links.
    """

    def __init__(self, urdf, displaced=None, springs=(), payload=None, heavier=(1.0,) * 6):
        model = pin.buildModelFromXML(urdf)
        flange = model.frames[model.getFrameId("flange")].placement
        placements = list(model.jointPlacements)
        for place, (shift, turn) in (displaced or {}).items():
            moved = pin.SE3(pin.exp3(np.array(turn)), np.array(shift))
            if place == "flange":
                flange = flange * moved
            else:
                placements[model.getJointId(place)] = placements[model.getJointId(place)] * moved
        self.model, self.actuated = pin.Model(), []
        parent, place = 0, pin.SE3.Identity()
        for index, link in enumerate(("base", *JOINTS)):
            if index:
                parent = self.model.addJoint(parent, model.joints[index], place, link)
                self.actuated.append(parent - 1)
                place = pin.SE3.Identity()
            carrier = parent
            for ends in (False, True):
                if ends:
                    carrier = parent
                    place = place * (flange if link == "A6" else placements[index + 1])
                for name, axis in springs:
                    if name == link and axis.startswith("end_") == ends:
                        kind = KINDS[axis.removeprefix("end_")]()
                        parent = self.model.addJoint(parent, kind, place, f"{name}.{axis}")
                        place = pin.SE3.Identity()
            if index:
                own = model.inertias[index]
                body = pin.Inertia(own.mass * heavier[index - 1], own.lever, own.inertia)
                self.model.appendBodyToJoint(carrier, body, pin.SE3.Identity())
        if payload is not None:
            mass, centre = payload
            self.model.appendBodyToJoint(parent, pin.Inertia(mass, np.array(centre), np.zeros((3, 3))), place)
        self.end = parent
        self.flange = place

    def with_tool(self, tool):
        """Return a model with the frame `tool`, and its data."""
        model = self.model.copy()
        model.addFrame(pin.Frame("tool", self.end, self.flange * pin.SE3(tool), pin.FrameType.OP_FRAME))
        return model, model.createData()

    def tcp(self, q, tool):
        """Pose and Jacobian of the tool at each row of q."""
        model, data = self.with_tool(tool)
        frame = model.getFrameId("tool")
        poses, jacobians = [], []
        for row in q:
            jacobians.append(pin.computeFrameJacobian(model, data, row, frame, pin.LOCAL_WORLD_ALIGNED))
            pin.framesForwardKinematics(model, data, row)
            poses.append(data.oMf[frame].homogeneous.copy())
        return np.array(poses), np.array(jacobians)

    def gravity(self, q):
        """∇U_g at each row of q."""
        data = self.model.createData()
        return np.array([pin.computeGeneralizedGravity(self.model, data, row) for row in q])

    def load_stiffness(self, q, tool, wrench):
        """∂(JᵀF)/∂q at each row of q, by the kinematic Hessian."""
        model, data = self.with_tool(tool)
        frame, out = model.getFrameId("tool"), []
        for row, force in zip(q, wrench, strict=True):
            pin.computeJointJacobians(model, data, row)
            pin.updateFramePlacements(model, data)
            pin.computeJointKinematicHessians(model, data, row)
            hessian = pin.getFrameKinematicHessian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            columns = hessian.reshape(-1).reshape(hessian.shape, order="F")  # the binding mistakes the order in memory
            out.append(np.einsum("kji,k->ji", columns, force))
        return np.array(out)
