"""A run as `mrr hammer` left it: result.json and telemetry.csv, checked, and the forward kinematics for drawings."""

import json
import pathlib
import warnings

import numpy as np

SCHEMA_VERSION = 1
MOVED_MM = 0.05  # a nail driven less shows as 0.0 mm


class ReportError(Exception):
    """One sentence for the user: what is wrong with which file."""


def read_json(path):
    try:
        with open(path, encoding="utf-8") as file:
            value = json.load(file)
    except OSError as error:
        raise ReportError(f"{path}: cannot be read: {error.strerror}") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ReportError(f"{path}: is not JSON: {error}") from None
    version = value.get("schema_version") if isinstance(value, dict) else None
    if version != SCHEMA_VERSION:
        raise ReportError(f"{path}: schema_version is {version!r}; this report understands {SCHEMA_VERSION}")
    return value


class Telemetry:
    """One row per millisecond; columns by their name without the unit: t["joint_2_position"]."""

    def __init__(self, path):
        try:
            with open(path, encoding="utf-8") as file:
                header = file.readline().strip()
                self._columns = {name.split(" [")[0]: k for k, name in enumerate(header.split(","))}
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of an empty file, which is an error of ours below
                    rows = np.loadtxt(file, delimiter=",", ndmin=2)
        except OSError as error:
            raise ReportError(f"{path}: cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise ReportError(f"{path}: is not a table of numbers: {error}") from None
        if rows.size == 0:
            raise ReportError(f"{path}: has no rows")
        if rows.shape[1] != len(self._columns):
            raise ReportError(f"{path}: the header has {len(self._columns)} columns, the rows have {rows.shape[1]}")
        self._path, self._rows = path, rows

    def __len__(self):
        return len(self._rows)

    def __getitem__(self, name):
        if name not in self._columns:
            raise ReportError(f"{self._path}: has no column {name!r}")
        return self._rows[:, self._columns[name]]


class Swing:
    """One swing of the result and its rows of telemetry; time counts from first touch (from its beginning if nothing
    was hit)."""

    def __init__(self, entry, telemetry):
        self.entry = entry
        self.number = entry["number"]
        self.hit = entry["hit"]
        self.contact_s = entry["contact_ms"] * 1e-3 if self.hit else 0.0
        zero = entry["contact_start_s"] if self.hit else entry["began_s"]
        time = telemetry["time"]
        moving = (telemetry["swing"] == self.number) & (time >= entry["began_s"] - 0.02)
        self._rows = np.flatnonzero(moving)
        self._telemetry = telemetry
        self.time_s = time[self._rows] - zero

    def __getitem__(self, column):
        return self._telemetry[column][self._rows]

    def between(self, begin_s, end_s):
        """Mask of the rows within these times."""
        return (self.time_s >= begin_s) & (self.time_s <= end_s)

    def passive_spans(self, joint):
        """[(begin, end)] in which the joint was in the passive law, s."""
        passive = np.concatenate(([0], (self[f"{joint}_passive"] > 0.5).astype(int), [0]))
        edges = np.diff(passive)
        begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        return [(self.time_s[b], self.time_s[min(e, len(self.time_s) - 1)]) for b, e in zip(begins, ends)]


class Run:
    """result.json and telemetry.csv of one folder."""

    def __init__(self, result_path, telemetry_path):
        self.result = read_json(result_path)
        try:
            self.telemetry = Telemetry(telemetry_path) if telemetry_path else None
            geometry = self.result["geometry"]
            self.joints = [joint["name"] for joint in geometry["joints"]]
            self.swings = [Swing(entry, self.telemetry) for entry in self.result["swings"]] if self.telemetry else []
            self.entries = self.result["swings"]
        except KeyError as error:
            raise ReportError(f"{result_path}: has no {error.args[0]!r}") from None
        self.hits = [swing for swing in self.swings if swing.hit]
        self.hit_entries = [entry for entry in self.entries if entry["hit"]]

    @property
    def mode(self):
        return self.result["mode"]

    def joint_entry(self, entry, joint):
        return next(j for j in entry["joints"] if j["name"] == joint)

    def passive_in(self, joint):
        """Numbers of the swings whose blow found the joint passive."""
        return [entry["number"] for entry in self.hit_entries if self.joint_entry(entry, joint)["passive"]]

    def ever_passive(self, joint):
        return bool(self.passive_in(joint))

    def passive_in_words(self, joint):
        """"active", "passive" if it was so in every blow, else "passive in swings 1, 3 to 5"."""
        numbers = self.passive_in(joint)
        if not numbers:
            return "active"
        if len(numbers) == len(self.hit_entries):
            return "passive"
        return f"passive in swing{'s' if len(numbers) > 1 else ''} {numbers_in_words(numbers)}"

    def moving(self, joint):
        """Whether the reference moves the joint in any swing."""
        return any(np.max(np.abs(s[f"{joint}_reference_velocity"]), initial=0.0) > 0.02 for s in self.swings)

    def hardest(self):
        """The blow that shows most, or None: with a passive joint if there is one, then one that moved the nail, then
        the one with the largest impulse."""
        return max(self.hits, default=None, key=lambda swing: (
            any(joint["passive"] for joint in swing.entry["joints"]), swing.entry["penetration_mm"] > MOVED_MM,
            swing.entry["impulse_measured_n_s"]))


def numbers_in_words(numbers):
    """[1, 3, 4, 5] is "1, 3 to 5"; `numbers` ascending."""
    runs = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(f"{a}" if a == b else f"{a}, {b}" if b == a + 1 else f"{a} to {b}" for a, b in runs)


def rotation_about(axis, angle):
    """Rotation matrix, by Rodrigues' formula; `axis` a unit vector, `angle` in rad."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


class ArmPose:
    """The chain at joint positions q (rad): origins and axes of the joints, and the hammer face, base frame, m."""

    def __init__(self, geometry, q):
        rotation, position = np.eye(3), np.zeros(3)
        self.joints, self.axes = [], []
        for joint, angle in zip(geometry["joints"], q):
            position = position + rotation @ np.array(joint["translation_m"])
            rotation = rotation @ np.array(joint["rotation"])
            self.joints.append(position)
            self.axes.append(rotation @ np.array(joint["axis"]))
            rotation = rotation @ rotation_about(joint["axis"], angle)
        face = geometry["face"]
        self.face = position + rotation @ np.array(face["translation_m"])
        self.face_axis = (rotation @ np.array(face["rotation"]))[:, 2]

    @property
    def handle(self):
        """Where the handle meets the head: the point of the head's axis nearest to the last joint."""
        return self.face - self.face_axis * max(0.0, float(np.dot(self.face - self.joints[-1], self.face_axis)))


def load(folder):
    """The run in `folder`. Throws ReportError."""
    folder = pathlib.Path(folder)
    return Run(folder / "result.json", folder / "telemetry.csv")


def load_comparison(folder, other):
    """Another run to compare with: `other` (a folder), or compare.json and compare.csv in `folder`; None if there is
    neither. Of a comparison telemetry is optional."""
    if other is not None:
        other = pathlib.Path(other)
        telemetry = other / "telemetry.csv"
        return Run(other / "result.json", telemetry if telemetry.is_file() else None)
    result, telemetry = pathlib.Path(folder) / "compare.json", pathlib.Path(folder) / "compare.csv"
    if not result.is_file():
        return None
    return Run(result, telemetry if telemetry.is_file() else None)
