"""A stand-in for RoboDK: answers the questions of `robolink` about a station over its socket, and nothing else.

The protocol is that of the package robodk (Apache licence): lines end with LF, numbers are big endian, poses go column
by column, and an int of status, 0 for good, ends each answer.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

ROBOT_ITEM = 2


@dataclass
class Arm:
    """A robot of the station; poses (4, 4) in mm."""

    name: str
    joints: list[float]
    frame: np.ndarray = field(default_factory=lambda: np.eye(4))
    tool: np.ndarray = field(default_factory=lambda: np.eye(4))
    flange: np.ndarray = field(default_factory=lambda: np.eye(4))


class _Talk:
    def __init__(self, connection: socket.socket, arms: list[Arm], opened: list[str]) -> None:
        self.stream, self.arms, self.opened = connection.makefile("rwb"), arms, opened

    def line(self) -> str:
        return self.stream.readline().decode().rstrip("\n")

    def number(self, kind: str = ">i"):
        return struct.unpack(kind, self.stream.read(struct.calcsize(kind)))[0]

    def array(self) -> list[float]:
        return [self.number(">d") for _ in range(self.number())]

    def arm(self) -> Arm:
        return self.arms[self.number(">Q") - 1]

    def pose(self, pose: np.ndarray) -> bytes:
        return struct.pack(">16d", *pose.T.ravel())

    def answer(self, command: str) -> bytes:
        if command == "RDK_API":
            self.array()
            return b"RDK_API\n" + struct.pack(">ii", 1, 25000)
        if command == "Add":
            self.opened.append(self.line())
            self.number(">Q")
            return struct.pack(">Qi", 99, 1)
        if command == "G_List_Items_Type_ptr":
            assert self.number() == ROBOT_ITEM
            numbers = range(1, len(self.arms) + 1)
            return struct.pack(">i", len(self.arms)) + b"".join(struct.pack(">Qi", n, ROBOT_ITEM) for n in numbers)
        if command == "G_Name":
            return self.arm().name.encode() + b"\n"
        if command == "G_Thetas":
            joints = self.arm().joints
            return struct.pack(f">i{len(joints)}d", len(joints), *joints)
        if command == "G_FK":
            joints, arm = self.array(), self.arm()
            assert joints == arm.joints
            return self.pose(arm.flange)
        return self.pose(getattr(self.arm(), {"G_Frame": "frame", "G_Tool": "tool"}[command]))

    def go_on(self) -> None:
        while command := self.line():
            self.stream.write(self.answer(command) + struct.pack(">i", 0))
            self.stream.flush()


@contextlib.contextmanager
def station(arms: list[Arm]) -> Iterator[tuple[int, list[str]]]:
    """Answer on a port; yield it, and the files that were opened."""
    opened: list[str] = []
    with socket.create_server(("localhost", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):  # closed
                while True:
                    connection, _ = server.accept()
                    with connection:
                        _Talk(connection, arms, opened).go_on()

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1], opened
