"""A robot that speaks libfranka's protocol, and a drawer in front of it: run in its own process.

It is franky-sim's MuJoCo world with one more body (`--empty`: without). Says where it listens, and
then answers lines on standard input, one line each:

    drawer      how far the drawer is open, m
    angles      the arm's true joint angles, rad
    reflex      ends the running motion as a robot does that has met something
    jam         from now on the drawer does not give
    drop        ends without a word, as a pulled cable does
"""

from __future__ import annotations

import json
import os
import sys
import xml.etree.ElementTree as ET
from contextlib import suppress

from franky_sim import SimulationServer
from franky_sim.franka_robot_protocol import MoveStatus, RobotCommand
from franky_sim.franka_server import BaseCommand
from franky_sim.mujoco_simulator import MujocoSimulator

# The handle, a bar along y, is where `tests/akm_fg/hardware/conftest.py` takes it to be.
HANDLE_M = (0.50, 0.0, 0.45)
FRONT_M = 0.05  # from the handle to the front behind it
HOME = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
FRICTION_N = 4.0
JAMMED_N_S_M = 1e6
# franky-sim's fingers are springs of 1 kN/m, which squeeze a bar of 12 mm with 6 N; Franka's hand
# squeezes with 70 N, at whatever width.
FINGER_N_M = 70.0 / 0.006
# A robot has a computer of its own, and libfranka gives it up after a second without a packet.
NICENESS = -10


def add_drawer(worldbody: ET.Element) -> None:
    """A front with a bar, sliding towards the robot."""
    x, y, z = HANDLE_M
    drawer = ET.SubElement(worldbody, "body", name="drawer", pos=f"{x} {y} {z}")
    ET.SubElement(
        drawer, "joint", name="drawer_slide", type="slide", axis="-1 0 0", range="0 0.3",
        frictionloss=str(FRICTION_N), damping="10",
    )  # fmt: skip
    bar = {"type": "box", "mass": "0.2", "friction": "1.5 0.05 0.001", "condim": "4"}
    ET.SubElement(drawer, "geom", size="0.006 0.07 0.006", **bar)
    for side in ("-0.065", "0.065"):
        ET.SubElement(drawer, "geom", pos=f"{FRONT_M / 2} {side} 0",
                      size=f"{FRONT_M / 2} 0.005 0.005", **bar)  # fmt: skip
    front = {"type": "box", "mass": "1.5"}
    ET.SubElement(drawer, "geom", pos=f"{FRONT_M + 0.01} 0 0", size="0.01 0.2 0.12", **front)


def _grip_without_creep(scene: ET.Element) -> None:
    """MuJoCo's default friction lets what is squeezed creep; its manual says how not to."""
    option = scene.find("option")
    assert option is not None
    option.set("cone", "elliptic")
    option.set("impratio", "50")


def _without_ground(worldbody: ET.Element) -> None:
    """The pedestal's height is the world's to say: the simulated ground goes out of reach."""
    ground = next(geom for geom in worldbody.iter("geom") if geom.get("name") == "ground")
    ground.set("pos", "0 0 -3")


def main() -> None:
    """Serve until standard input ends."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    with MujocoSimulator() as simulator:
        robot = simulator.add_robot(initial_q=HOME)
        robot._kp_hand[:] = FINGER_N_M
        if "--empty" in sys.argv:
            _without_ground(simulator.worldbody)
        else:
            add_drawer(simulator.worldbody)
        _grip_without_creep(simulator.scene)
        with SimulationServer(simulator) as server:
            server.run_async()
            print(robot.hostname, flush=True)
            for line in sys.stdin:
                print(_answer(line.strip(), simulator, server), flush=True)


def _answer(command: str, simulator: MujocoSimulator, server: SimulationServer) -> str:
    if command == "drawer":
        joint = simulator.model.joint("drawer_slide")
        return json.dumps(float(simulator.data.qpos[joint.qposadr[0]]))
    if command == "angles":
        return json.dumps(list(server.robot_servers[0].robot.inner_state.q))
    if command == "jam":
        joint = simulator.model.joint("drawer_slide")
        simulator.model.dof_damping[joint.dofadr[0]] = JAMMED_N_S_M
        return "null"
    if command == "reflex":
        at = server.robot_servers[0]
        motion = at.current_motion_id
        at.reset_current_motion_id()
        at.stop_motion(send_preemption_signal=False)
        BaseCommand.send_response(
            at._tcp_socket, RobotCommand.kMove, motion, MoveStatus.kReflexAborted
        )
        return "null"
    if command == "drop":
        os._exit(1)
    raise ValueError(f"unknown command {command!r}")


if __name__ == "__main__":
    main()
