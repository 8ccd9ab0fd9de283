"""The supervisor's model and impact prediction against Pinocchio.

mrr_model_dump prints our numbers at random states. Pinocchio gets the example robots from their URDF by its own parser (so the
robot loader is compared too) and random chains from the description in the dump. The blow is solved here as one linear system
with multipliers, not with the mobility formula the product uses; where Pinocchio's own impulse dynamics applies, by that as well.
"""

import json
import subprocess

import numpy as np
import pinocchio as pin
import pytest

TOLERANCE = 1e-9
STATES = 40
SOURCES = ["mrr3", "arm7"] + [f"random:{n}" for n in (1, 2, 3, 5, 7, 10, 16)]


def chain_model(robot):
    """Pinocchio model of a dumped description, and its face frame."""
    model = pin.Model()
    model.gravity.linear = np.array(robot["gravity"])
    parent = 0
    for joint in robot["joints"]:
        offset = pin.SE3(np.array(joint["offset"]["rotation"]), np.array(joint["offset"]["translation"]))
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(np.array(joint["axis"])), offset, joint["name"])
        inertia = pin.Inertia(joint["mass"], np.array(joint["com"]), np.array(joint["inertia"]))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    face = pin.SE3(np.array(robot["face"]["rotation"]), np.array(robot["face"]["translation"]))
    return model, model.addFrame(pin.Frame("face", parent, 0, face, pin.FrameType.OP_FRAME))


@pytest.fixture(scope="module", params=SOURCES)
def dump(request, program, source_dir):
    """(model, face frame id, description, states)"""
    source = request.param
    directory = source_dir / "robots" / source
    argument = source if source.startswith("random:") else str(directory)
    output = subprocess.run(
        [program("tests/unit/impact/mrr_model_dump"), argument, "7", str(STATES)], check=True, capture_output=True, text=True
    ).stdout
    dumped = json.loads(output)
    robot = dumped["robot"]
    if source.startswith("random:"):
        model, face = chain_model(robot)
    else:
        model = pin.buildModelFromUrdf(str(directory / "robot.urdf"))
        assert [n for n in model.names][1:] == [j["name"] for j in robot["joints"]]
        face = model.getFrameId("hammer_face")
        assert face < model.nframes
    assert model.nv == len(robot["joints"])
    assert len(dumped["states"]) == STATES
    return model, face, robot, dumped["states"]


def close(ours, theirs, what):
    ours, theirs = np.array(ours), np.array(theirs)
    assert ours.shape == theirs.shape, what
    difference = np.max(np.abs(ours - theirs)) / max(1.0, np.max(np.abs(theirs)))
    assert difference < TOLERANCE, f"{what}: {difference}"


def face_jacobian(model, data, face, q):
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    J = pin.getFrameJacobian(model, data, face, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return np.reshape(J, (6, model.nv))  # Pinocchio hands out a vector for a single joint


def links_mass(model, data, q):
    M = pin.crba(model, data, q).copy()
    return np.triu(M) + np.triu(M, 1).T


def test_kinematics_and_dynamics(dump):
    model, face, _, states = dump
    data = model.createData()
    for state in states:
        q, qd, qdd = (np.array(state[k]) for k in ("q", "qd", "qdd"))
        J = face_jacobian(model, data, face, q)
        close(state["face_position"], data.oMf[face].translation, "face position")
        close(state["face_rotation"], data.oMf[face].rotation, "face rotation")
        close(state["jacobian"], J, "J")
        close(state["mass"], links_mass(model, data, q), "M")
        close(state["gravity"], pin.computeGeneralizedGravity(model, data, q), "g")
        close(state["bias"], pin.nonLinearEffects(model, data, q, qd), "h")
        close(state["torque"], pin.rnea(model, data, q, qd, qdd), "inverse dynamics")


def rotor_matrix(robot, axes, model):
    """B from gear ratios, rotor inertias and joint axes in the base frame."""
    n = len(robot["joints"])
    B = np.zeros((n, n))
    for i, joint in enumerate(robot["joints"]):
        gear, inertia = joint["gear_ratio"], joint["rotor_inertia"]
        B[i, i] = gear**2 * inertia
        for j in range(i if model == "sym" else 0):
            B[i, j] = B[j, i] = gear * inertia * (axes[i] @ axes[j])
    return B


def test_rotors(dump):
    model, face, robot, states = dump
    data = model.createData()
    for state in states:
        axes = face_jacobian(model, data, face, np.array(state["q"]))[3:].T
        for variant in ("diag", "sym"):
            close(state[f"rotors_{variant}"], rotor_matrix(robot, axes, variant), variant)


def test_blow(dump):
    model, face, robot, states = dump
    data = model.createData()
    n = model.nv
    compared = 0
    for state in states:
        blow = state["blow"]
        q, qd, normal = np.array(state["q"]), np.array(blow["qd"]), np.array(blow["normal"])
        J = face_jacobian(model, data, face, q)
        M = links_mass(model, data, q)
        extra = np.diag([e if h == "controlled" else 0.0 for h, e in zip(blow["holds"], blow["extra_inertia"])])
        H = M + rotor_matrix(robot, J[3:].T, blow["rotors"]) + extra
        lever = J[:3].T @ normal
        held = [i for i in range(n) if blow["holds"][i] == "held"]
        compliance = 0.0 if blow["nail_mass"] is None else 1.0 / blow["nail_mass"]
        if len(held) == n and compliance == 0.0:
            assert not blow["feasible"]
            continue
        # Unknown: jump of joint speeds, impulse on the face, impulses that keep the held joints where they are.
        E = np.eye(n)[held]
        size = n + 1 + len(held)
        system, right = np.zeros((size, size)), np.zeros(size)
        system[:n, :n] = H
        system[:n, n], system[n, :n] = -lever, lever
        system[:n, n + 1 :], system[n + 1 :, :n] = -E.T, E
        system[n, n] = compliance
        right[n] = -(1.0 + blow["restitution"]) * (lever @ qd)
        solution = np.linalg.solve(system, right)
        delta_qd, impulse = solution[:n], solution[n]
        assert blow["feasible"] and impulse > 0.0
        close(blow["impulse"], impulse, "P")
        close(blow["delta_qd"], delta_qd, "delta qd")
        close(blow["axis_impulse"], lever * impulse - M @ delta_qd, "axis impulse")
        compared += 1
    assert compared > STATES // 2


def test_free_arm_on_a_rigid_board_by_pinocchios_impulse_dynamics(dump):
    model, face, robot, states = dump
    model = model.copy()
    model.armature = np.array([j["gear_ratio"] ** 2 * j["rotor_inertia"] for j in robot["joints"]])
    data = model.createData()
    compared = 0
    for state in states:
        blow = state["blow"]
        if blow["rotors"] != "diag" or blow["nail_mass"] is not None or set(blow["holds"]) != {"free"}:
            continue
        q, qd, normal = np.array(state["q"]), np.array(blow["qd"]), np.array(blow["normal"])
        constraint = (normal @ face_jacobian(model, data, face, q)[:3])[None, :]
        after = pin.impulseDynamics(model, data, q, qd, constraint, blow["restitution"], 0.0)
        close(blow["delta_qd"], after - qd, "delta qd")
        close([blow["impulse"]], np.abs(data.impulse_c), "P")
        compared += 1
    assert compared > 0
