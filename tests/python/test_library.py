"""The Python package: it computes what Pinocchio computes, refuses what cannot be used, and its examples run."""

import os
import pathlib
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest

EXAMPLES = sorted((pathlib.Path(__file__).parents[2] / "examples" / "python").glob("[0-9]*.py"))


@pytest.fixture(scope="session")
def package_dir(build_dir):
    folder = build_dir / "bindings" / "python"
    assert list((folder / "mrr").glob("_mrr*.so")), f"the Python package was not built in {folder}"
    return folder


@pytest.fixture(scope="session")
def mrr(package_dir):
    sys.path.insert(0, str(package_dir))
    import mrr as package

    return package


@pytest.fixture(params=["mrr3", "arm7"])
def robot(request, mrr, source_dir):
    return mrr.load_robot(source_dir / "robots" / request.param)


def test_free_blow_is_pinocchios(mrr, robot, source_dir):
    folder = "mrr3" if robot.dof == 3 else "arm7"
    model = pin.buildModelFromUrdf(str(source_dir / "robots" / folder / "robot.urdf"))
    model.armature = np.diag(robot.rotor_matrix(np.zeros(robot.dof)))
    data = model.createData()
    face = model.getFrameId("hammer_face")
    random = np.random.default_rng(3)
    struck = 0
    for _ in range(30):
        q, qd = random.uniform(-1, 1, robot.dof), random.uniform(-1, 1, robot.dof)
        J = robot.jacobian(q)
        constraint = J[2:3]
        if constraint @ qd > 0:
            qd = -qd
        blow = mrr.predict(robot, q=q, qd=qd, joints=["passive"] * robot.dof, rotor_model="diag", restitution=0.4,
                           model="instant")
        after = pin.impulseDynamics(model, data, q, qd, constraint, 0.4, 0.0)
        np.testing.assert_allclose(blow.delta_qd, after - qd, atol=1e-9)
        np.testing.assert_allclose(blow.blow_impulse_nm_s, model.armature * blow.delta_qd, atol=1e-9)
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(robot.face(q)[0], data.oMf[face].translation, atol=1e-12)
        struck += blow.impulse_n_s > 0
    assert struck == 30


def test_every_model_predicts_a_planned_blow(mrr, robot):
    wood = mrr.ContactLaw()
    wood.nail_resistance_n, wood.nail_resistance_slope_n_m, wood.nail_room_m = 40.0, 400.0, 0.04
    blow = mrr.plan(robot).predict_input(wood)
    made = [mrr.predict(robot, blow, model) for model in ("instant", "finite_time", "resolved")]
    assert all(p.feasible and p.approaching for p in made)
    # A blow of an instant has no weight pressing on the nail while the contact lasts.
    assert 0.5 < made[0].impulse_n_s < min(made[1].impulse_n_s, made[2].impulse_n_s)
    assert all(0.0 < p.penetration_m <= wood.nail_room_m for p in made[1:])
    # The default is the model measured best.
    assert mrr.predict(robot, blow).impulse_n_s == made[2].impulse_n_s
    # Several robots of the description: a range with the blow in it.
    several = mrr.predict(robot, blow, robots=5)
    assert several.impulse_low_n_s < several.impulse_high_n_s
    assert several.impulse_low_n_s <= several.impulse_n_s <= several.impulse_high_n_s
    for name in ("axis_impulse", "peak_torque"):
        unit = {"axis_impulse": "nm_s", "peak_torque": "nm"}[name]
        low, value, high = (getattr(several, f"{name}{word}_{unit}") for word in ("_low", "", "_high"))
        assert (low <= value).all() and (value <= high).all() and (low < high).any()


def test_plan_reaches_the_head_and_explains_itself(mrr, robot):
    plan = mrr.plan(robot)
    task = robot.plan_input()
    position, rotation = robot.face(plan.q_impact)
    np.testing.assert_allclose(position, task.head_position_m, atol=4e-3)
    assert -task.normal @ (robot.jacobian(plan.q_impact)[:3] @ plan.qd_impact) == pytest.approx(plan.speed_m_s)
    q, qd, _ = plan.strike([plan.contact_time_s])
    np.testing.assert_allclose(q[0], plan.q_impact, atol=1e-9)
    np.testing.assert_allclose(qd[0], plan.qd_impact, atol=1e-9)
    assert plan.poses[0].note == "chosen" and plan.selections[0].passive == plan.passive
    assert plan.selections_weighed == 2**robot.dof
    for unit in ("rad/s", "N m s", "N s", "m/s", "%"):
        assert unit in str(plan)
    assert mrr.plan(robot).q_impact.tolist() == plan.q_impact.tolist()


def test_changing_one_field_changes_the_plan(mrr, robot):
    soft = mrr.plan(robot, nail_mass_kg=10.0, wanted_penetration_m=0.004)
    assert soft.speed_m_s < mrr.plan(robot, nail_mass_kg=10.0).speed_m_s


def test_what_cannot_be_used_is_refused_by_name(mrr, robot):
    n = robot.dof
    zero = np.zeros(n)
    cases = [
        (lambda: mrr.plan(robot, restitution=1.5), ["restitution", "1.5"]),
        (lambda: mrr.plan(robot, head_position_m=[9.0, 0, 0]), ["mm away"]),
        (lambda: mrr.plan(robot, start=np.zeros(n + 1)), ["start", str(n)]),
        (lambda: mrr.plan(robot, start=np.zeros(99)), ["start", "99"]),
        (lambda: mrr.plan(robot, mode="sometimes"), ["mode", "sometimes", "planned"]),
        (lambda: mrr.predict(robot, q=np.full(n, np.nan), qd=zero), ["q", "finite"]),
        (lambda: mrr.predict(robot, q=zero, qd=zero, normal=[0, 0, 2]), ["normal"]),
        (lambda: mrr.predict(robot, q=zero, qd=zero, joints=["limp"] * n), ["joints", "limp", "passive"]),
        (lambda: mrr.predict(robot, q=zero, qd=zero, model="best"), ["model", "best", "resolved"]),
        (lambda: mrr.measure(robot, zero, "beauty"), ["measure", "beauty", "load_ratio"]),
        (lambda: mrr.measure(robot, np.zeros(n + 1)), ["q", "joint"]),
        (lambda: robot.jacobian(np.zeros(n + 2)), ["q"]),
        (lambda: mrr.load_robot("/nowhere"), ["/nowhere"]),
    ]
    for call, words in cases:
        with pytest.raises(mrr.InputError) as caught:
            call()
        for word in words:
            assert word in str(caught.value), caught.value
    with pytest.raises(TypeError, match="PlanInput has no field 'restitutoin'"):
        mrr.plan(robot, restitutoin=1.0)


def test_map_agrees_with_the_measure_at_its_poses(mrr, source_dir):
    robot = mrr.load_robot(source_dir / "robots" / "mrr3")
    field = mrr.measure_map(robot, "effective_mass", columns=12, rows=9)
    assert field.values.shape == (9, 12) and np.isfinite(field.values).sum() > 10
    # Reachable only within the arm's length of its shoulder.
    x, z = np.meshgrid(field.along_m, field.up_m)
    assert np.all(np.isnan(field.values[np.hypot(x, z - 0.48) > 0.761]))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_example(example, package_dir, source_dir):
    environment = dict(os.environ, PYTHONPATH=str(package_dir))
    done = subprocess.run([sys.executable, "-W", "error", str(example)], capture_output=True, text=True, timeout=120,
                          env=environment, cwd=source_dir / "robots")
    assert done.returncode == 0, done.stderr
    assert len(done.stdout) > 100


@pytest.mark.slow
def test_wheel_installs_and_plans(source_dir, tmp_path):
    built = subprocess.run([source_dir / "scripts" / "wheel"], capture_output=True, text=True, timeout=1800)
    assert built.returncode == 0, built.stderr
    wheel = built.stdout.strip()
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--target",
                    str(tmp_path), wheel], check=True, timeout=120)
    code = "import mrr; p = mrr.plan(mrr.load_robot('mrr3')); print(mrr.__file__, p.speed_m_s)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=tmp_path,
                          env=dict(os.environ, PYTHONPATH=str(tmp_path)))
    assert done.returncode == 0, done.stderr
    where, speed = done.stdout.split()
    assert where.startswith(str(tmp_path)) and float(speed) > 0.1
