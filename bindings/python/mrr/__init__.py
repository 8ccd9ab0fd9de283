"""Predict and plan the blow of a hammering robot: `load_robot`, `predict`, `plan`, `measure`, `measure_map`.

SI units and radians throughout; vectors are numpy arrays in joint order or in the robot's base frame. What cannot be used is
refused with `InputError` (a ValueError) naming the field, its value, unit and what is allowed. docs/library.md has more.
"""

import os
import pathlib

from ._mrr import (ContactLaw, InputError, JointLoad, MeasureMap, PlanInput, PoseCandidate, PredictInput, Prediction, Robot,
                   SelectionCandidate, StrikePlan, _load_robot, _map, _measure, _plan, _predict, measures)

__all__ = ["ContactLaw", "InputError", "JointLoad", "MeasureMap", "PlanInput", "PoseCandidate", "PredictInput", "Prediction",
           "Robot", "SelectionCandidate", "StrikePlan", "load_robot", "measure", "measure_map", "measures", "plan", "predict"]


def load_robot(folder):
    """Robot of a folder with robot.urdf and robot.yaml, or of an example's name ("mrr3", "arm7")."""
    path = pathlib.Path(os.fspath(folder))
    example = pathlib.Path(__file__).parent / "robots" / path
    return _load_robot(str(example if not path.exists() and example.is_dir() else path))


def _changed(what, changes):
    for name, value in changes.items():
        if name.startswith("_") or not hasattr(type(what), name):
            raise TypeError(f"{type(what).__name__} has no field '{name}'")
        setattr(what, name, value)
    return what


def plan(robot, input=None, **changes):
    """Plans a blow on the robot's nail: StrikePlan. `input`: a PlanInput, by default that of the robot's own task;
    keyword arguments change fields of it."""
    return _plan(robot, _changed(robot.plan_input() if input is None else PlanInput(input), changes))


def predict(robot, input=None, model="resolved", **changes):
    """What a blow does: Prediction, by `model` "instant", "finite_time" or "resolved" (measured best). `input`: a PredictInput
    (of a plan: `plan.predict_input()`); keyword arguments change fields of it. With `robots=9` the blow is tried with nine robots
    of this description; the Prediction is the one in their middle, its `..._low` and `..._high` fields are their range."""
    return _predict(robot, _changed(PredictInput(robot) if input is None else PredictInput(input), changes), model)


def measure(robot, q, name="load_ratio", normal=(0.0, 0.0, 1.0), restitution=1.0, nail_mass_kg=float("inf"), contact_s=0.05):
    """An impact measure at pose `q` (rad); `measures` has the names with unit, meaning and source."""
    return _measure(robot, q, name, normal, restitution, nail_mass_kg, contact_s)


def measure_map(robot, name="load_ratio", columns=64, rows=48, restitution=1.0, nail_mass_kg=float("inf"), contact_s=None,
                max_tilt_rad=0.0):
    """An impact measure over the vertical plane of base and nail: MeasureMap with arrays `values` (rows from the bottom, NaN
    out of reach), `along_m`, `up_m`."""
    return _map(robot, name, columns, rows, restitution, nail_mass_kg,
                robot.contact_duration_s if contact_s is None else contact_s, max_tilt_rad)
