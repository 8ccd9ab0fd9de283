"""The emulator's free motion against MuJoCo, with a model built here from the printed masses alone.

Links and rotors are bodies of their own, the transmission is a spring and damper between the rotor's angle over its
gear and the joint's: elastic joints, rotor coupling and gyroscopic torques are all part of the comparison.
"""

import json
import subprocess

import mujoco
import numpy as np
import pytest


def numbers(values):
    return " ".join(repr(float(v)) for v in np.ravel(values))


def model_of(dump):
    """MJCF of the chain: rotor i is a body in link i-1, massless but for its spin inertia."""
    joints = dump["joints"]
    rotations = [np.array(j["offset_rotation"]).reshape(3, 3) for j in joints]
    inertias = [np.array(j["inertia"]).reshape(3, 3) for j in joints]
    rotors = []
    for i, joint in enumerate(joints):
        axis = np.array(joint["axis"])
        along = np.outer(axis, axis)
        # A body needs inertia across its axis too; what the rotor brings along, the carrying link gives up, because the
        # links of the description already contain their rotors at rest.
        rotor = joint["rotor_inertia"] * (along + 0.5 * (np.eye(3) - along))
        rotors.append(rotor)
        if i > 0:
            inertias[i - 1] = inertias[i - 1] - rotations[i] @ rotor @ rotations[i].T

    def inertial(mass, com, inertia):
        full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        return f'<inertial mass="{mass!r}" pos="{numbers(com)}" fullinertia="{numbers(full)}"/>'

    opened, closed = "", ""
    for i, joint in enumerate(joints):
        r = rotations[i]
        place = f'pos="{numbers(joint["offset_translation"])}" xyaxes="{numbers([r[:, 0], r[:, 1]])}"'
        axis = numbers(joint["axis"])
        opened += f'<body {place}><joint name="rotor{i}" type="hinge" axis="{axis}"/>'
        opened += inertial(1e-9, [0, 0, 0], rotors[i]) + "</body>\n"
        opened += f'<body {place}><joint name="link{i}" type="hinge" axis="{axis}"/>'
        opened += inertial(joint["mass"][0], joint["com"], inertias[i]) + "\n"
        closed += "</body>"
    tendons = "".join(
        f'<fixed stiffness="{j["stiffness"]!r}" damping="{j["damping"]!r}" springlength="0">'
        f'<joint joint="rotor{i}" coef="{1 / j["gear"]!r}"/><joint joint="link{i}" coef="-1"/></fixed>\n'
        for i, j in enumerate(joints)
    )
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian" balanceinertia="false" boundmass="0" boundinertia="0"/>
        <option timestep="5e-5" integrator="RK4" gravity="{numbers(dump["gravity"])}"/>
        <worldbody>{opened}{closed}</worldbody><tendon>{tendons}</tendon></mujoco>"""
    )


def mujoco_motion(dump):
    model = model_of(dump)
    data = mujoco.MjData(model)
    n = len(dump["joints"])
    link = [model.joint(f"link{i}").qposadr[0] for i in range(n)]
    rotor = [model.joint(f"rotor{i}").qposadr[0] for i in range(n)]
    gear = np.array([j["gear"] for j in dump["joints"]])
    data.qpos[link] = dump["trajectory"][0]["link"]
    data.qpos[rotor] = gear * dump["trajectory"][0]["motor"]
    mujoco.mj_forward(model, data)
    motion = []
    for sample in dump["trajectory"]:
        while data.time < sample["t"] - 1e-9:
            mujoco.mj_step(model, data)
        motion.append(np.concatenate([data.qpos[link], data.qpos[rotor] / gear]))
    return np.array(motion)


@pytest.mark.parametrize("robot, time_s, tolerance_rad", [("mrr3", 1.0, 1e-6), ("arm7", 0.8, 1e-6)])
def test_free_swing(program, source_dir, robot, time_s, tolerance_rad):
    worst = {}
    for substep_us in (100, 25):
        tool = program("tests/unit/plant/mrr_plant_dump")
        command = [tool, source_dir / "robots" / robot, "--time", str(time_s), "--substep", str(substep_us)]
        dump = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        plant = np.array([s["link"] + s["motor"] for s in dump["trajectory"]])
        assert np.ptp(plant, axis=0).min() > 0.01, "every joint has to move for this to mean anything"
        worst[substep_us] = np.abs(plant - mujoco_motion(dump)).max()
    print(f"{robot}: largest difference {worst[100]:.2e} rad at 100 us, {worst[25]:.2e} rad at 25 us")
    assert worst[100] < tolerance_rad
    assert worst[25] < worst[100] / 8  # second order: 16
