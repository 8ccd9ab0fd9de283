"""The figures. Each `draw_*` draws on axes it is given, so that page and overview picture share them. Time counts from
first touch."""

import numpy as np

from . import style
from .data import ArmPose
from .style import plt

PANEL = (4.7, 3.3)  # inches; two side by side on a desk, one below the other on a phone
MODE_COLOURS = {"planned": style.BLUE, "never": style.ORANGE, "always": style.PURPLE}
MODE_LABELS = {"planned": "planned switching", "never": "never passive", "always": "always passive"}
LABEL_BOX = {"fc": style.PAPER, "ec": "none", "alpha": 0.8, "pad": 0.6}
POSES = 6  # ghosted poses on the way in


def joint_label(name):
    return name.replace("_", " ")


def joint_colour(run, joint):
    return style.JOINT_COLOURS[run.joints.index(joint) % len(style.JOINT_COLOURS)]


def colours(swings):
    return [style.swing_colour(k, len(swings)) for k in range(len(swings))]


def swing_axis(ax, entries):
    """One place per swing; bars of few swings are not blown up."""
    count, room = len(entries), max(0, 4 - len(entries)) / 2
    ax.set(xlabel="swing", xticks=range(count), xlim=(-0.6 - room, count - 0.4 + room))
    ax.set_xticklabels([str(entry["number"]) for entry in entries])
    ax.grid(axis="x", visible=False)


def shade_contact(ax, hits, label=True):
    """From first touch to the mean end of contact."""
    end_ms = 1e3 * np.mean([swing.contact_s for swing in hits])
    ax.axvspan(0, end_ms, color=style.SHADE, lw=0, zorder=0)
    if label:
        ax.annotate("contact", (end_ms / 2, 1), xycoords=("data", "axes fraction"), xytext=(0, -2),
                    textcoords="offset points", ha="center", va="top", color=style.MUTED, fontsize=8)


def legend_below(ax, **options):
    """Under the label of the time axis, where no curve is."""
    options = {"ncols": 3, "columnspacing": 1.2, "title_fontsize": 8} | options
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.4, **options)


# ---------------------------------------------------------------------------------------------------------- the arm


def plane_of(points, gravity_up=np.array([0.0, 0.0, 1.0])):
    """Base of the plane that holds the points best: (right, up), unit vectors."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    up = gravity_up - normal * (gravity_up @ normal)
    if np.linalg.norm(up) < 0.3:  # the plane lies flat
        up = np.array([0.0, 1.0, 0.0]) - normal * normal[1]
    up /= np.linalg.norm(up)
    return np.cross(up, normal), up


def swing_poses(run, swing):
    """Poses from the start of the back-swing's way down to first touch, evenly along the face's path, as they were."""
    q = np.column_stack([swing[f"{joint}_link_position"] for joint in run.joints])
    face = np.column_stack([swing["face_x"], swing["face_y"], swing["face_z"]])
    before = np.flatnonzero(swing.time_s <= 0.0)
    touch = before[-1] if len(before) else 0
    start = int(np.argmax(np.linalg.norm(face[:touch + 1] - face[touch], axis=1)))
    path = face[start:touch + 1]
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    rows = start + np.searchsorted(length, np.linspace(0, length[-1], POSES)).clip(0, len(path) - 1)
    return [ArmPose(run.result["geometry"], q[row]) for row in rows], path


def label_joint(ax, at, chain, text, passive):
    """The joint's name on the side where no link is."""
    away = np.zeros(2)
    for point in chain:
        distance = np.linalg.norm(at - point)
        if 1e-6 < distance:
            away += (at - point) / distance**3
    away = away / np.linalg.norm(away) if np.linalg.norm(away) > 1e-6 else np.array([-1.0, 0.0])
    if away[1] < -0.9 and at[1] <= chain[:, 1].min() + 0.02:
        away = np.array([-0.8, 0.8])  # clear of the base
    align = "center" if abs(away[0]) < 0.5 else ("left" if away[0] > 0 else "right")
    level = "center" if abs(away[1]) < 0.5 else ("bottom" if away[1] > 0 else "top")
    ax.annotate(text, at, xytext=10 * away,
                textcoords="offset points", ha=align, va=level, fontsize=8, linespacing=1.15, zorder=23,
                color=style.BLUE if passive else style.INK, bbox=LABEL_BOX)


def draw_arm(ax, run, swing):
    """Side view, to scale: the way in of one blow as it really was, nail and board."""
    geometry = run.result["geometry"]
    poses, path = swing_poses(run, swing)
    nail = np.array(geometry["nail_position_m"])
    normal = np.array(geometry["nail_normal"])
    base = np.zeros(3)
    right, up = plane_of(np.vstack([path, nail, base] + [p for pose in poses for p in pose.joints + [pose.face]]))
    if right @ (nail - base) < 0:
        right = -right

    def flat(point):
        return np.array([right @ point, up @ point])

    touch = poses[-1]

    # Board and nail.
    n, across = flat(normal), flat(np.cross(normal, np.cross(up, right)))
    hole = flat(nail)
    before_m = 1e-3 * (swing.entry["nail_height_mm"] + swing.entry["penetration_mm"])
    half, deep = 0.11, 0.055
    corners = [hole + half * across, hole - half * across, hole - half * across - deep * n,
               hole + half * across - deep * n]
    ax.fill(*zip(*corners), fc=style.WOOD, ec=style.MUTED, lw=0.8, zorder=1)
    head = hole + before_m * n
    ax.plot(*zip(head, hole - 0.03 * n), color=style.INK, lw=1.4, zorder=2, solid_capstyle="butt")
    ax.plot(*zip(head + 0.009 * across, head - 0.009 * across), color=style.INK, lw=2.2, zorder=2)

    # Base, and joints whose axis lies in the plane of the drawing.
    foot = flat(base)
    ax.plot([foot[0] - 0.09, foot[0] + 0.09], [foot[1]] * 2, color=style.INK, lw=2.5, solid_capstyle="butt", zorder=1)

    radius = 1e-3 * geometry["face_radius_mm"]
    for k, pose in enumerate(poses):
        last = k == len(poses) - 1
        alpha = 1.0 if last else 0.13 + 0.32 * k / (len(poses) - 1)
        links = np.array([flat(p) for p in [base] + pose.joints + [pose.handle]])
        ax.plot(links[:, 0], links[:, 1], color=style.STEEL, lw=7 if last else 5, alpha=alpha, zorder=3 + k,
                solid_joinstyle="round")
        axis, face = flat(pose.face_axis), flat(pose.face)
        side = np.array([-axis[1], axis[0]])
        back = face - axis * max(0.06, 2.0 * float(np.dot(pose.face - pose.handle, pose.face_axis)))
        block = [face + radius * side, face - radius * side, back - radius * side, back + radius * side]
        ax.fill(*zip(*block), fc=style.INK, ec="none", alpha=alpha, zorder=4 + k)
    trail = np.array([flat(p) for p in path])
    ax.plot(trail[:, 0], trail[:, 1], color=style.ORANGE, lw=1.2, ls=(0, (4, 2)), zorder=20)

    normal_of_plane = np.cross(right, up)
    others = np.array([flat(p) for pose in poses for p in pose.joints + [pose.handle]])
    for joint, origin, axis in zip(run.joints, touch.joints, touch.axes):
        at = flat(origin)
        passive = run.joint_entry(swing.entry, joint)["passive"]
        if abs(axis @ normal_of_plane) < 0.7:  # seen from the side
            tip = flat(axis) * 0.1
            ax.plot(*zip(at - 0.5 * tip, at + tip), color=style.MUTED, lw=1.0, ls=(0, (6, 2, 1, 2)), zorder=21)
        else:
            ax.plot(*at, "o", ms=8.5, mfc=style.PAPER if passive else style.INK,
                    mec=style.BLUE if passive else style.INK, mew=2.2 if passive else 1, zorder=22)
        text = f"{joint_label(joint)}\n{'passive' if passive else 'active'}"
        label_joint(ax, at, others, text if len(run.joints) <= 4 else joint_label(joint), passive)
    ax.annotate("back-swing", trail[0], xytext=(7, 4), textcoords="offset points", fontsize=8, color=style.ORANGE)
    ax.annotate(f"nail {1e3 * before_m:.0f} mm proud,\ndriven {swing.entry['penetration_mm']:.1f} mm", hole,
                xytext=(0, -21), textcoords="offset points", fontsize=8, ha="center", va="top", color=style.INK)
    ax.set_aspect("equal")
    ax.set(xlabel="m", ylabel="m")
    ax.margins(0.05, 0.04)
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, hole[1] - 0.15), high)
    ax.set_xlim(min(ax.get_xlim()[0], foot[0] - 0.24), ax.get_xlim()[1] + 0.04)
    ax.set_title(f"Swing {swing.number}: face at {swing.entry['speed_m_s']:.2f} m/s at first touch")


def draw_nail_height(ax, run):
    """Height after each swing: really, and as the robot believes."""
    geometry = run.result["geometry"]
    really = [geometry["nail_height_mm"]] + [entry["nail_height_mm"] for entry in run.entries]
    believed = [entry["seen_by_robot"]["nail_height_mm"] for entry in run.entries]
    numbers = np.arange(len(really))
    shown = numbers[::-(-len(numbers) // 13)]
    top = max(really + believed)
    ax.axhspan(-0.09 * really[0], 0, color=style.WOOD, lw=0)
    ax.vlines(numbers, 0, really, color=style.INK, lw=2.2, zorder=3)
    ax.plot(numbers, really, "_", ms=16, color=style.INK, mew=3, zorder=3, label="really")
    ax.plot(numbers[1:], believed, "o", ms=7, mfc="none", color=style.ORANGE, mew=1.5, label="the robot's estimate",
            zorder=4)
    for number in sorted({*shown, numbers[-1]}):
        height, circle = really[number], believed[number - 1] if number else 0.0
        above = circle if height < circle < height + 0.13 * top else height  # clear of the circle
        ax.annotate(f"{height:.1f}", (number, above), xytext=(0, 8), textcoords="offset points", ha="center",
                    fontsize=8)
    room = max(0, 4 - len(really)) / 2
    ax.set_xlim(-0.6 - room, len(really) - 0.4 + room)
    ax.set(xlabel="after swing", ylabel="nail above the board [mm]", ylim=(-0.09 * really[0], 1.15 * top), xticks=shown)
    ax.set_xticklabels(["start" if number == 0 else str(number) for number in ax.get_xticks()])
    ax.grid(axis="x", visible=False)
    legend_below(ax)
    ax.set_title("Nail height")


# --------------------------------------------------------------------------------------------------------- the blow


def draw_force(ax, run, legend=True):
    hits = run.hits
    end_s = max(swing.contact_s for swing in hits) + 0.03
    for colour, swing in zip(colours(hits), hits):
        rows = swing.between(-0.02, end_s)
        time_ms = 1e3 * swing.time_s[rows]
        seen = swing.entry["seen_by_robot"]["impulse_n_s"]
        ax.plot(time_ms, swing["contact_force"][rows], color=colour, zorder=3,
                label=f"{swing.number}: {swing.entry['impulse_measured_n_s']:.2f} ({seen:.2f}) N s")
        ax.plot(time_ms, swing["estimated_force"][rows], color=colour, lw=1.0, ls=(0, (3, 2)), zorder=2)
    ax.set(xlabel="time from first touch [ms]", ylabel="contact force [N]", xlim=(-20, 1e3 * end_s))
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    if legend:
        legend_below(ax, title="swing: impulse (robot's estimate)")
    ax.set_title("Contact force, and the robot's own estimate (dashed)")


def draw_impulses(ax, run):
    entries = run.hit_entries
    numbers = np.arange(len(entries))
    bars = (("predicted", "impulse_predicted_n_s", style.SKY), ("measured", "impulse_measured_n_s", style.BLUE))
    for k, (label, key, colour) in enumerate(bars):
        ax.bar(numbers + (k - 1) * 0.27, [entry[key] for entry in entries], 0.25, color=colour, label=label, zorder=3)
    ax.bar(numbers + 0.27, [entry["seen_by_robot"]["impulse_n_s"] for entry in entries], 0.25, color=style.ORANGE,
           label="the robot's estimate", zorder=3)
    ax.set(ylabel="impulse [N s]", ylim=(0, 1.2 * ax.get_ylim()[1]))
    swing_axis(ax, entries)
    ax.legend(loc="upper right", ncols=3, columnspacing=1.0)
    ax.set_title("Impulse of each blow")


# ------------------------------------------------------------------------------------------------------- the joints


def torque_limits(ax, joint_entry, low, high):
    """Rated and repeated-peak lines on the side the torque goes to (the positive one if there is next to none), and the
    view that shows them."""
    rated, repeated = joint_entry["rated_nm"], joint_entry["repeated_peak_nm"]
    sign = -1.0 if -low > max(high, 0.02 * rated) else 1.0
    for value, name, dashes in ((rated, "rated", (0, (4, 2))), (repeated, "repeated peak", "-")):
        for side in (sign, -sign):
            if side != sign and not (-sign * (low if sign > 0 else high) > 0.6 * value):
                continue
            ax.axhline(side * value, color=style.INK, lw=1.1, ls=dashes, zorder=2)
            if side == sign:
                ax.annotate(f"{name} {value:g} Nm", (0, side * value), xycoords=("axes fraction", "data"),
                            xytext=(3, 2 if side > 0 else -2), textcoords="offset points", ha="left",
                            va="bottom" if side > 0 else "top", fontsize=8, zorder=6, bbox=LABEL_BOX)
    far = 1.13 * max(repeated, high if sign > 0 else -low)
    near = 1.15 * (low if sign > 0 else high)
    ax.set_ylim(*((min(near, -0.06 * far), far) if sign > 0 else (-far, max(near, 0.06 * far))))


def draw_torque(ax, run, joint, other=None, title=True):
    """Transmission torque through every blow, against the limits; another run beside it."""
    hits = run.hits
    begin_s, end_s = -0.06, max(swing.contact_s for swing in hits) + 0.12
    low = high = 0.0
    compared = other is not None and other.hits
    for each in ([other] if compared else []) + [run]:
        for colour, swing in zip(colours(each.hits), each.hits):
            rows = swing.between(begin_s, end_s)
            torque = swing[f"{joint}_transmission_torque"][rows]
            low, high = min(low, torque.min(initial=0.0)), max(high, torque.max(initial=0.0))
            ax.plot(1e3 * swing.time_s[rows], torque, lw=1.2, zorder=4 if each is run else 3,
                    color=MODE_COLOURS[each.mode] if compared else colour, alpha=0.85 if compared else 1.0,
                    label=(MODE_LABELS[each.mode] if compared else f"{swing.number}")
                    if swing is each.hits[0] or not compared else None)
    shade_contact(ax, hits, label=False)
    torque_limits(ax, run.joint_entry(run.hit_entries[0], joint), low, high)
    ax.set(xlabel="time from first touch [ms]", ylabel="transmission torque [Nm]", xlim=(1e3 * begin_s, 1e3 * end_s))
    if title:
        mode = run.passive_in_words(joint)
        ax.set_title(f"{joint_label(joint)}, {'passive at impact' if mode == 'passive' else mode}")
    if compared:
        legend_below(ax)
    elif len(hits) <= style.LARGEST_SERIES:
        legend_below(ax, title="swing", ncols=6)


def draw_torque_shares(ax, run, other=None):
    """Peak torque in contact of every joint and swing, as a share of its repeated peak."""
    entries, count = run.hit_entries, len(run.joints)
    width = 0.84 / count

    def bar_of(entry, joint):
        blow = run.joint_entry(entry, joint)
        return 100 * blow["peak_torque_nm"] / blow["repeated_peak_nm"], 100 * blow["rated_nm"] / blow[
            "repeated_peak_nm"]

    numbers = np.arange(len(entries))
    wide, aside = (0.43 * width, 0.22 * width) if other is not None else (0.86 * width, 0.0)
    for k, joint in enumerate(run.joints):
        at = numbers + (k - (count - 1) / 2) * width
        shares, rated = zip(*(bar_of(entry, joint) for entry in entries))
        ax.bar(at - aside, shares, wide, color=joint_colour(run, joint), zorder=3,
               label=joint_label(joint) + (f" ({run.passive_in_words(joint)})" if run.ever_passive(joint) else ""))
        ax.hlines(rated, at - 0.45 * width, at + 0.45 * width, color=style.INK, lw=1.2, zorder=4,
                  label="rated torque" if k == 0 else None)
        if other is not None:
            pairs = list(zip(at, other.hit_entries))
            ax.bar([x + aside for x, _ in pairs], [bar_of(entry, joint)[0] for _, entry in pairs], wide, fc="none",
                   ec=joint_colour(run, joint), hatch="/////", lw=0.8, zorder=3,
                   label=MODE_LABELS[other.mode] if k == count - 1 else None)
    ax.axhline(100, color=style.INK, lw=1.1)
    ax.annotate("repeated peak", (1, 100), xycoords=("axes fraction", "data"), xytext=(-2, 2),
                textcoords="offset points", ha="right", va="bottom", fontsize=8)
    ax.set(ylabel="peak torque in contact\n[% of repeated peak]", ylim=(0, max(118, 1.08 * ax.get_ylim()[1])))
    swing_axis(ax, entries)
    legend_below(ax)
    ax.set_title("Peak torque of every blow against the gears' limits")


def draw_position_error(ax, run, joint):
    """Reference minus position while the joint is active; the reference follows a passive joint, so that means nothing
    then."""
    for colour, swing in zip(colours(run.hits), run.hits):
        error = 1e3 * (swing[f"{joint}_reference"] - swing[f"{joint}_position"])
        error[swing[f"{joint}_passive"] > 0.5] = np.nan
        rows = (swing.time_s >= -1.0) & (swing.time_s <= 1.0)
        ax.plot(swing.time_s[rows], error[rows], color=colour, lw=1.1, label=f"{swing.number}", zorder=3)
    low, high = ax.get_ylim()
    ax.set_ylim(min(low, -1.0), max(high, 1.0))  # less than a milliradian is not worth magnifying
    ax.axvspan(0, np.mean([swing.contact_s for swing in run.hits]), color=style.SHADE, lw=0, zorder=0)
    ax.set(xlabel="time from first touch [s]", ylabel="reference − position [mrad]")
    if len(run.hits) <= style.LARGEST_SERIES:
        legend_below(ax, title="swing", ncols=6)
    ax.set_title(f"Position error, {joint_label(joint)}")


VELOCITY_MARGIN_S = 0.25  # shown before first touch and after the end of contact


def switches(swing, joint):
    """[(time, to passive)] of the joint within the velocity figure, s from first touch."""
    times = [pair for begin, end in swing.passive_spans(joint) for pair in ((begin, True), (end, False))]
    return [(time, passive) for time, passive in times
            if -VELOCITY_MARGIN_S <= time <= swing.contact_s + VELOCITY_MARGIN_S]


def draw_motor_velocity(ax, run, swing):
    """An active and a passive joint through one blow, and when the passive one switched."""
    passive = [joint for joint in run.joints if run.joint_entry(swing.entry, joint)["passive"]]
    active = [joint for joint in run.joints if joint not in passive]

    def speed(joint):
        return np.max(np.abs(swing[f"{joint}_motor_velocity"][swing.between(-0.1, 0.2)]), initial=0.0)

    chosen = [max(group, key=speed) for group in (active, passive) if group]
    rows = swing.between(-VELOCITY_MARGIN_S, swing.contact_s + VELOCITY_MARGIN_S)
    for joint in chosen:
        colour = joint_colour(run, joint)
        name = f"{joint_label(joint)}, {'passive' if joint in passive else 'active'}"
        ax.plot(1e3 * swing.time_s[rows], swing[f"{joint}_motor_velocity"][rows], color=colour, label=name, zorder=4)
        reference = swing[f"{joint}_reference_velocity"][rows].copy()
        reference[swing[f"{joint}_passive"][rows] > 0.5] = np.nan
        ax.plot(1e3 * swing.time_s[rows], reference, color=colour, lw=1.0, ls=(0, (3, 2)), zorder=3)
        for time, to_passive in switches(swing, joint):
            ax.axvline(1e3 * time, color=colour, lw=1.0, ls=(0, (1, 1.5)), zorder=2)
            ax.annotate("passive" if to_passive else "active again", (1e3 * time, 0),
                        xycoords=("data", "axes fraction"), xytext=(-3 if to_passive else 3, 3),
                        textcoords="offset points", ha="right" if to_passive else "left", color=colour, fontsize=8)
    shade_contact(ax, [swing])
    ax.axhline(0, color=style.MUTED, lw=0.8, zorder=1)
    ax.set(xlabel="time from first touch [ms]", ylabel="motor velocity, joint side [rad/s]")
    ax.margins(y=0.12)
    ax.legend(loc="lower right" if not passive else "best")
    ax.set_title(f"Motor velocity through blow {swing.number} (reference dashed)")


# ------------------------------------------------------------------------------------------------------- experiment


def draw_experiment(ax, series, quantity, label, share, least):
    """Published against simulated, one mark per swing: on the line they agree, in the band within the tolerance (`share`
    of the published value, at least `least`). A bar spans what was published where swings cannot be told apart."""
    largest = 0.0
    markers = (("o", style.BLUE), ("s", style.ORANGE), ("^", style.GREEN))
    for (marker, colour), board in zip(markers, series):
        points = [(s["published"][quantity], s[quantity]) for s in board["swings"]]
        points = [(p, s) for p, s in points if p is not None and s is not None]
        span = board.get(f"measured_{quantity}")
        if span:
            heights = [s[quantity] for s in board["swings"] if s[quantity] is not None]
            ax.hlines(heights, *span, color=colour, lw=2.5, label=board["board"], zorder=3)
            largest = max([largest, span[1]] + heights)
        elif points:
            published, simulated = np.array(points).T
            ax.plot(published, simulated, marker, color=colour, ms=6.5, mec=style.PAPER, mew=0.7, label=board["board"],
                    zorder=4)
            largest = max(largest, published.max(), simulated.max())
    largest = 1.1 * largest or 1.0
    line = np.linspace(0, largest, 50)
    width = np.maximum(share * line, least)
    ax.fill_between(line, line - width, line + width, color=style.SHADE, lw=0, zorder=0)
    ax.plot(line, line, color=style.INK, lw=1.0, zorder=2)
    ax.set(xlabel=f"published {label}", ylabel=f"simulated {label}", xlim=(0, largest), ylim=(0, largest))
    ax.locator_params(nbins=6)
    ax.set_aspect("equal")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right")


# ----------------------------------------------------------------------------------------------------------- README


def most_telling_joint(run):
    """The passive joint with the largest load if it were held; else the joint nearest to its limit."""
    passive = [joint for joint in run.joints if run.ever_passive(joint)]
    if passive:
        held = {j["name"]: j["held_nm_s"] / j["rated_limit_nm_s"] for j in run.hit_entries[0]["plan"]["joints"]}
        return max(passive, key=held.get)

    def share(joint):
        blows = [run.joint_entry(entry, joint) for entry in run.hit_entries]
        return max(blow["peak_torque_nm"] / blow["repeated_peak_nm"] for blow in blows)

    return max(run.joints, key=share)


def overview(run, other=None):
    figure = plt.figure(figsize=(12, 6), facecolor=style.PAPER)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.12, 1))
    draw_arm(figure.add_subplot(grid[:, 0]), run, run.hits[0])
    draw_force(figure.add_subplot(grid[0, 1]), run)
    joint = most_telling_joint(run)
    draw_torque(figure.add_subplot(grid[1, 1]), run, joint, other)
    return figure
