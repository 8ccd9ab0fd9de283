"""The page: headline, figures with what they show in words, tables. One HTML file without scripts or outside parts."""

import html as escape_module
import io
import itertools
import pathlib
import re

import numpy as np

from . import data, figures, style
from .style import plt


def escape(text):
    """For HTML; a percent sign stays with its number."""
    return escape_module.escape(str(text)).replace(" %", "\u00a0%")


def fixed(value, digits=2):
    """A number, or a dash for one that is unknown."""
    if value is None:
        return "–"
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def span(values, digits, unit):
    """"3 to 5 ms", or "3 ms" if that is all."""
    low, high = fixed(min(values), digits), fixed(max(values), digits)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"


def mass(value):
    return "∞" if value is None else fixed(value, 1)


# ------------------------------------------------------------------------------------------------------------- parts


def figure(name, caption, draw, size=figures.PANEL):
    """One figure: `draw` gets the axes."""
    drawing, axes = plt.subplots(figsize=size)
    draw(axes)
    svg = style.inline_svg(drawing, name, escape(caption.split(". ")[0]))
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def is_number(text):
    return text.lstrip("−+").replace(".", "").replace(" %", "").isdigit() or text in ("–", "∞", "")


def table(head, rows, caption="", mark=(), groups=()):
    """`rows`: lists of texts; columns of numbers are aligned to the right. `mark`: indices of rows set off. `groups`:
    a head above each column, one cell over equal neighbours."""
    rows = [[str(text) for text in row] for row in rows]
    right = [all(is_number(row[k]) for row in rows) for k in range(len(head))]

    def cells(tag, row):
        return "".join(f"<{tag}{' class=n' if right[k] else ''}>{escape(text)}</{tag}>" for k, text in enumerate(row))

    body = "".join(f"<tr{' class=mark' if k in mark else ''}>{cells('td', row)}</tr>" for k, row in enumerate(rows))
    head = [re.sub(r"\[.*\]", lambda unit: unit[0].replace(" ", "\u00a0"), text) for text in head]
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    over = "".join(f'<th class=over colspan={len(list(columns))}>{escape(name)}</th>'
                   for name, columns in itertools.groupby(groups))
    over = f"<tr>{over}</tr>" if over else ""
    tight = " class=tight" if len(head) > 10 else ""
    return (f'<div class="scroll"><table{tight}>{title}<thead>{over}<tr>{cells("th", head)}</tr></thead><tbody>{body}</tbody>'
            "</table></div>")


def grid(*parts, kind="grid"):
    return f'<div class="{kind}">{"".join(parts)}</div>'


def section(title, *parts):
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def paragraph(text):
    return f"<p>{escape(text)}</p>" if text else ""


# ---------------------------------------------------------------------------------------------------------- headline


def signed_span(percents):
    low, high = (f"{value:+.0f} %".replace("-", "−") for value in (min(percents), max(percents)))
    return low if low == high else f"{low} to {high}"


def board(result):
    """Its name; a path is shortened to the file's."""
    return pathlib.PurePath(result["board"]).stem


def headline(run):
    result = run.result
    passed = "pass" if result["success"] else "fail"
    tiles = (
        ("nail", f"{fixed(result['nail_height_mm'], 2)} mm", "flush" if result["flush"] else "not flush"),
        ("swings", len(run.entries), f"from {fixed(result['geometry']['nail_height_mm'], 0)} mm"),
        ("limits", "kept" if result["within_limits"] else "broken", "no gear above its repeated peak, no switch too late"
         if result["within_limits"] else "see above"),
        ("speed", f"{fixed(result['realtime_factor'], 0)} ×", f"real time; {fixed(result['simulated_s'], 1)} s simulated"),
        ("CAN bus", f"{fixed(100 * result['bus_load'], 0)} %",
         f"loaded; {fixed(100 * result['bus_load_worst_case'], 0)} % computed for the worst case"))
    cards = "".join(f"<div><dt>{escape(name)}</dt><dd><b>{escape(value)}</b><span>{escape(text)}</span></dd></div>"
                    for name, value, text in tiles)
    verdict = sentence(result["reason"])
    if not result["within_limits"]:
        verdict += f" But limits were broken: {sentence(result['limit_note'])}"
    mode = figures.MODE_LABELS[run.mode]
    formulation = ", equations as printed by the reference" if result["formulation"] == "as_printed" else ""
    return (f"<header><p class=kicker>MRR hammering report</p><h1>{escape(result['robot'])} on {escape(board(result))}"
            f"</h1><p class='verdict {passed}'>{escape(verdict)}</p>"
            f"<p class=small>{escape(mode)}, seed {result['seed']}{formulation}</p><dl>{cards}</dl></header>")


def sentence(text):
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!")) else text + "."


# ------------------------------------------------------------------------------------------------------------ wording


def force_in_words(run):
    entries = run.hit_entries
    off = [abs(e["seen_by_robot"]["impulse_n_s"] / e["impulse_measured_n_s"] - 1) for e in entries
           if e["impulse_measured_n_s"] > 0]
    return (f"Contact force of every blow, by a force sensor under the board. Contacts last "
            f"{span([e['contact_ms'] for e in entries], 0, 'ms')}; from its joints alone the robot estimates the impulse with a mean error of {fixed(100 * np.mean(off), 0)} %. "
            f"The dashed estimate is filtered and sampled at the knot rate, so it trails by about 10 ms.")


def impulses_in_words(run):
    off = [e["impulse_predicted_n_s"] / e["impulse_measured_n_s"] - 1 for e in run.hit_entries
           if e["impulse_measured_n_s"] > 0]
    return (f"Impulse predicted before each blow, measured, and estimated by the robot. The prediction is off by "
            f"{signed_span([100 * share for share in off])}.")


def torque_in_words(run, joint):
    blows = [run.joint_entry(entry, joint) for entry in run.hit_entries]
    peak = max(blow["peak_torque_nm"] for blow in blows)
    leads = [blow["switch_lead_ms"] for blow in blows if blow["passive"] and blow["switch_lead_ms"] is not None]
    text = (f"{figures.joint_label(joint)}: at most {fixed(peak, 1)} Nm in contact, "
            f"{fixed(100 * peak / blows[0]['repeated_peak_nm'], 0)} % of the repeated peak.")
    if leads:
        mode = run.passive_in_words(joint)
        begin = "Wholly passive" if mode == "passive" else sentence(mode)[:-1] + ", wholly so"
        text += f" {begin} {span(leads, 1, 'ms')} before first touch."
    return sentence(text)


def velocity_in_words(run, swing):
    text = f"Motor velocities through blow {swing.number}"
    if len(run.hits) > 1:
        same = [each for each in run.hits if bool(passive_joints(each)) == bool(passive_joints(swing))]
        moved = [each for each in same if each.entry["penetration_mm"] > data.MOVED_MM]
        kind = []
        if len(same) < len(run.hits):
            kind.append("with a passive joint")
        if moved and len(moved) < len(same):
            kind.append("that moved the nail")
        text += f", of those {' '.join(kind)} the one" if kind else ", the one"
        text += " with the largest impulse"
    if any(figures.switches(swing, joint) for joint in passive_joints(swing)):
        text += "; dotted: when a joint went passive or came back"
    return sentence(text)


def passive_joints(swing):
    return [joint["name"] for joint in swing.entry["joints"] if joint["passive"]]


def comparison_in_words(run, other):
    """By how much the passive joints are relieved, absolutely and per newton second of blow: the runs may strike
    differently hard."""
    parts = []
    for joint in run.joints:
        if run.ever_passive(joint) == other.ever_passive(joint):
            continue

        def mean_peak(each):
            blows = [(each.joint_entry(e, joint)["peak_torque_nm"], e["impulse_measured_n_s"]) for e in each.hit_entries]
            return (float(np.mean([peak for peak, _ in blows])),
                    float(np.mean([peak / impulse for peak, impulse in blows if impulse > 0])))

        (ours, ours_per), (theirs, theirs_per) = mean_peak(run), mean_peak(other)
        parts.append(f"{figures.joint_label(joint)}: mean peak torque {fixed(ours, 1)} Nm with "
                     f"{figures.MODE_LABELS[run.mode]}, {fixed(theirs, 1)} Nm with "
                     f"{figures.MODE_LABELS[other.mode]} ({change(ours, theirs)}); per newton second of blow "
                     f"{fixed(ours_per, 1)} against {fixed(theirs_per, 1)} Nm ({change(ours_per, theirs_per)}).")
    if not parts:
        return "No joint is passive in one run and active in the other."
    return " ".join(parts)


def change(ours, theirs):
    percent = 100 * (ours / theirs - 1)
    return f"{abs(percent):.0f} % {'lower' if percent < 0 else 'higher'}"


# ------------------------------------------------------------------------------------------------------------- tables


def plan_tables(run):
    plan = run.result["plan"]
    parts = [paragraph(sentence(plan["why"]))]
    degrees = fixed(np.degrees(plan["tilt_rad"]), 1) if plan["tilt_rad"] is not None else "–"
    parts.append(
        table(("first blow", "value"), (
            ("pose at impact [rad]", ", ".join(fixed(q, 3) for q in plan["q_impact_rad"])),
            ("joint velocities at impact [rad/s]", ", ".join(fixed(v, 3) for v in plan["qd_impact_rad_s"])),
            ("back-swing starts at [rad]", ", ".join(fixed(q, 3) for q in plan["q_back_swing_rad"])),
            ("speed of the face along the nail [m/s]", fixed(plan["speed_m_s"], 3)),
            ("tilt of the face [°]", degrees),
            ("impulse predicted [N s]", fixed(plan["impulse_predicted_n_s"])),
            ("effective mass of the arm [kg]", fixed(plan["effective_mass_kg"])),
            ("reference goes past the head by [mm]", fixed(plan["follow_through_mm"], 1)),
            ("contact after, switch before it [ms]", f"{fixed(1e3 * plan['contact_time_s'], 0)}, "
             f"{fixed(1e3 * (plan['contact_time_s'] - plan['switch_time_s']), 0)}"))))
    parts.append(
        table(("axis impulse [N m s]", "all free", "held", "planned", "rated limit", "repeated-peak limit", "at impact"),
              [(figures.joint_label(j["name"]), fixed(j["free_nm_s"], 3), fixed(j["held_nm_s"], 3),
                fixed(j["planned_nm_s"], 3), fixed(j["rated_limit_nm_s"], 3), fixed(j["repeated_peak_limit_nm_s"], 3),
                "passive" if j["passive"] else "active") for j in plan["joints"]]))
    selections = table(
        ("passive joints", "largest load over rated, per N s", "impulse [N s]", "feasible", "why"),
        [(", ".join(figures.joint_label(name) for k, name in enumerate(run.joints) if s["passive"] >> k & 1) or "none",
          fixed(s["load_ratio_per_n_s"], 3), fixed(s["impulse_n_s"]), "yes" if s["feasible"] else "no", s["note"])
         for s in plan["selections"]], mark=[k for k, s in enumerate(plan["selections"]) if s["note"] == "chosen"])
    poses = table(
        ("pose [rad]", "tilt [°]", "speed [m/s]", "measure", "feasible", "why"),
        [(", ".join(fixed(q, 2) for q in p["q_rad"]), fixed(np.degrees(p["tilt_rad"]), 1), fixed(p["speed_m_s"], 3),
          fixed(p["measure"], 3), "yes" if p["feasible"] else "no", p["note"]) for p in plan["poses"]],
        mark=[k for k, p in enumerate(plan["poses"]) if p["note"] == "chosen"])
    parts.append(f"<details><summary>Which joints could go passive: {len(plan['selections'])} weighed</summary>"
                 f"{selections}</details>")
    parts.append(f"<details><summary>Poses: {len(plan['poses'])} weighed</summary>{poses}</details>")
    return "".join(parts)


def swings_tables(run):
    head = ("swing", "nail after [mm]", "penetration [mm]", "contact [ms]", "speed [m/s]", "impulse predicted [N s]",
            "measured [N s]", "robot's estimate [N s]", "peak force [N]", "effective mass M* [kg]", "e", "reference past head [mm]")
    rows = []
    for e in run.entries:
        if not e["hit"]:
            rows.append((str(e["number"]), fixed(e["nail_height_mm"]), e["aborted"] or "nothing hit") + ("–",) * 9)
            continue
        rows.append((str(e["number"]), fixed(e["nail_height_mm"]), fixed(e["penetration_mm"]), fixed(e["contact_ms"], 0),
                     fixed(e["speed_m_s"], 3), fixed(e["impulse_predicted_n_s"]), fixed(e["impulse_measured_n_s"]),
                     fixed(e["seen_by_robot"]["impulse_n_s"]), fixed(e["peak_force_n"], 1), mass(e["effective_mass_kg"]),
                     fixed(e["restitution"]), fixed(e["plan"]["follow_through_mm"], 1)))
    blows = [(str(e["number"]), figures.joint_label(j["name"]), "passive" if j["passive"] else "active",
              fixed(j["peak_torque_nm"], 1), fixed(j["peak_torque_swing_nm"], 1), fixed(j["rated_nm"], 0),
              fixed(j["repeated_peak_nm"], 0), fixed(j["axis_impulse_predicted_nm_s"], 3),
              fixed(j["axis_impulse_nm_s"], 3), fixed(j["switch_lead_ms"], 1)) for e in run.hit_entries for j in e["joints"]]
    return table(head, rows) + table(
        ("swing", "joint", "at impact", "peak torque in contact [Nm]", "in the whole swing [Nm]", "rated [Nm]",
         "repeated peak [Nm]", "axis impulse planned [N m s]", "measured [N m s]", "passive before touch [ms]"), blows,
        "Planned axis impulses are those of the blow alone, without sign; measured ones contain gravity and "
        "catching the arm.")


# --------------------------------------------------------------------------------------------------------- experiment


def experiment_section(experiment):
    """The reference's experiment: published beside simulated."""
    series = experiment["series"]
    quantities = (("contact_ms", "contact [ms]", 0), ("impulse_n_s", "impulse [N s]", 2),
                  ("penetration_mm", "penetration [mm]", 1), ("effective_mass_kg", "effective mass M* [kg]", 1))
    within = [swing["within"] for board in series for swing in board["swings"]]
    words = "All swings are" if all(within) else f"{sum(within)} of {len(within)} swings are"
    parts = [f"<p class='verdict {'pass' if all(within) else 'fail'}'>"
             + escape(f"{words} within the tolerances: contact 15 %, impulse 25 %, penetration 10 % or 0.5 mm.") + "</p>"]
    tolerances = ((0.15, 0.0), (0.25, 0.0), (0.10, 0.5))
    if "robot" in experiment:
        parts.append(f"<p class=small>{escape(experiment['robot'])}, seed {escape(experiment['seed'])}</p>")
    parts.append(grid(*(figure(f"experiment{k}", f"Published and simulated {label.split(' [')[0]}. On the line they "
                               "agree, in the band within the tolerance.", lambda ax, q=quantity, l=label, t=tolerance:
                               figures.draw_experiment(ax, series, q, l, *t), (3.5, 3.3))
                        for k, ((quantity, label, _), tolerance) in enumerate(zip(quantities, tolerances))),
                      kind="grid small-figures"))
    for board in series:
        head, groups = ["swing", "reference past head [mm]"], ["", ""]
        for _, label, _ in quantities:
            head += ["sim.", "publ.", "off by"]
            groups += [label] * 3
        head, groups = head + ["within tolerance"], groups + [" "]
        rows = []
        for swing in board["swings"]:
            row = [swing["name"], fixed(swing.get("past_head_mm"), 2)]
            for quantity, _, digits in quantities:
                ours, theirs = swing[quantity], swing["published"][quantity]
                off = "–" if ours is None or not theirs else f"{100 * (ours / theirs - 1):+.0f} %".replace("-", "−")
                row += [fixed(ours, digits), fixed(theirs, digits), off]
            rows.append(row + ["yes" if swing["within"] else "no"])
        told = [k for k in range(len(head)) if any(row[k] != "–" for row in rows)]
        head, groups, *rows = ([row[k] for k in told] for row in (head, groups, *rows))
        ranges = ""
        if "measured_contact_ms" in board:
            low, high = board["measured_contact_ms"]
            soft, hard = board["measured_impulse_n_s"]
            ranges = (f"; the reference measured {fixed(low, 0)} to {fixed(high, 0)} ms and {fixed(soft)} to "
                      f"{fixed(hard)} N s over all its swings")
        parts.append(table(head, rows, f"{board['board']}{ranges}", groups=groups))
    return section("The reference's experiment, repeated", *parts)


def reference_tables_section(tables):
    """Published figures beside what the equations give."""
    return section("The reference's tables, recomputed", table(
        ("table", "quantity", "published", "computed", "reproduced", "note"),
        [(t["table"], t["quantity"], f"{t['published']:g}", f"{t['computed']:.4g}", "yes" if t["reproduced"] else "no",
          t["note"]) for t in tables]))


# --------------------------------------------------------------------------------------------------------------- page

CSS = """
*{box-sizing:border-box}
body{margin:0 auto;max-width:66rem;padding:1.2rem 1rem 3rem;font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,
"DejaVu Sans",Arial,sans-serif;color:INK;background:PAPER}
h1{font-size:1.9rem;line-height:1.15;margin:.1rem 0 .5rem}h2{font-size:1.25rem;margin:2.2rem 0 .6rem;padding-top:.7rem;
border-top:1px solid GRID}p{margin:.4rem 0 .8rem;max-width:46rem}
.kicker{color:MUTED;font-size:.85rem;margin:0}.small{color:MUTED;font-size:.88rem;margin:0}
.verdict{font-size:1.1rem;padding:.1rem 0 .1rem .8rem;border-left:5px solid}.pass{border-color:GREEN}.fail{border-color:ORANGE}
dl{display:grid;grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr));gap:.6rem 1.4rem;margin:1.2rem 0 0}
dl div{border-top:2px solid INK;padding-top:.3rem}dt{color:MUTED;font-size:.85rem}dd{margin:0}dd b{display:block;
font-size:1.45rem;line-height:1.3}dd span{font-size:.82rem;line-height:1.35;color:MUTED;display:block}
.grid.small-figures{grid-template-columns:repeat(auto-fill,minmax(min(100%,17rem),1fr))}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,24rem),1fr));gap:1.4rem 1.8rem;align-items:start}
figure{margin:0}figure svg{display:block;width:100%;height:auto;max-width:48rem}ul{padding-left:1.2rem}figcaption{font-size:.86rem;color:MUTED;line-height:1.4;
margin-top:.2rem}
.scroll{overflow-x:auto;margin:.8rem 0 1.2rem}table{border-collapse:collapse;font-size:.86rem;
font-variant-numeric:tabular-nums}th,td{padding:.28rem .7rem;text-align:left;border-bottom:1px solid GRID;
vertical-align:top}th{font-weight:600;vertical-align:bottom;border-bottom:1.5px solid INK;min-width:4.2rem;line-height:1.25}
.tight th,.tight td{padding:.28rem .32rem;min-width:0}.tight{font-size:.82rem}.over{border-bottom:0;text-align:center}
.n{text-align:right}td.n,td:nth-child(-n+3){white-space:nowrap}caption{text-align:left;font-weight:600;
padding-bottom:.3rem}.mark td{font-weight:600;background:SHADE}summary{cursor:pointer;margin:.3rem 0}code{font-size:.92em}
@media print{body{max-width:none;font-size:10pt;padding:0}.grid{grid-template-columns:1fr 1fr}.grid.small-figures{
grid-template-columns:1fr 1fr 1fr}figure,tr{break-inside:avoid}h2{break-after:avoid}
.scroll{overflow:visible}table{font-size:7.5pt}th,td{padding:.15rem .3rem;min-width:0}th{min-width:0}}
"""


FILES = (("result.json", "everything above as numbers"), ("experiment.json", "the experiment as numbers"),
         ("telemetry.csv", "one row per millisecond"),
         ("bus.log", "every CAN frame; <code>canplayer</code> and python-can read it"))


def stylesheet():
    text = CSS
    for name in ("INK", "MUTED", "GRID", "PAPER", "SHADE", "GREEN", "ORANGE"):
        text = text.replace(name, style.variable(getattr(style, name)))
    return style.css() + text


def run_sections(run, other):
    parts = [headline(run)]
    if run.hits:
        hardest = run.hardest()
        joints = "; ".join(f"{figures.joint_label(j['name'])} {'passive' if j['passive'] else 'active'}"
                           for j in hardest.entry["joints"])
        parts.append(section("The swing", grid(
            figure("arm", f"The way in of blow {hardest.number}, to scale, as it was, not as planned; dashed: path of "
                   f"the face. At impact: {joints}.", lambda ax: figures.draw_arm(ax, run, hardest), (5.2, 4.4)),
            figure("nail", "Height of the nail's head above the board after each swing.",
                   lambda ax: figures.draw_nail_height(ax, run), (4.7, 4.0)))))
        parts.append(section("The blow", grid(
            figure("force", force_in_words(run), lambda ax: figures.draw_force(ax, run)),
            figure("impulse", impulses_in_words(run), lambda ax: figures.draw_impulses(ax, run), (4.7, 3.0)))))
        torques = [figure(f"torque{k}", torque_in_words(run, joint),
                          lambda ax, j=joint: figures.draw_torque(ax, run, j, other))
                   for k, joint in enumerate(run.joints)]
        shares = figure("shares", "Largest torque of each joint while in contact, per blow; the mark on a bar is the "
                        "rated torque.", lambda ax: figures.draw_torque_shares(ax, run, other))
        words = paragraph(sentence(comparison_in_words(run, other))) if other is not None and other.hit_entries else ""
        parts.append(section("What the gears carry", words, grid(*torques, shares)))
        quiet = {joint for joint in run.joints if not run.moving(joint) and run.ever_passive(joint)}
        followed = [joint for joint in run.joints if joint not in quiet]
        parts.append(section("How the joints move", grid(
            figure("velocity", velocity_in_words(run, hardest),
                   lambda ax: figures.draw_motor_velocity(ax, run, hardest)),
            *(figure(f"error{k}", f"How far {figures.joint_label(joint)} lags behind its reference; shaded: contact.",
                     lambda ax, j=joint: figures.draw_position_error(ax, run, j)) for k, joint in enumerate(followed)))))
    else:
        parts.append(section("No blow", paragraph("Nothing was hit, so there is nothing to draw.")))
    if run.result["plan"]:
        parts.append(section("The plan", plan_tables(run)))
    if run.entries:
        parts.append(section("The swings", swings_tables(run)))
    if run.result.get("tables"):
        parts.append(reference_tables_section(run.result["tables"]))
    return parts


def belongs(folder, experiment, result):
    """Whether an experiment goes with the result beside it: of the same robot, or made after it. An older one of another
    robot was left behind."""
    return (experiment.get("robot") == result["robot"]
            or (folder / "experiment.json").stat().st_mtime > (folder / "result.json").stat().st_mtime)


def html(folder, compare_folder=None):
    """The whole page. Throws ReportError."""
    folder = pathlib.Path(folder)
    parts, title, files = [], "MRR hammering report", FILES
    experiment = None
    if (folder / "experiment.json").is_file():
        experiment = data.read_json(folder / "experiment.json")
    if experiment is None or (folder / "result.json").is_file():
        run = data.load(folder)
        other = data.load_comparison(folder, compare_folder)
        title = f"{run.result['robot']} on {board(run.result)}"
        parts += run_sections(run, other)
        if experiment is not None and not belongs(folder, experiment, run.result):
            experiment = None
            files = [file for file in files if file[0] != "experiment.json"]
        if experiment is None and "experiment" in run.result:
            experiment = {"series": run.result["experiment"]}
    if experiment is not None:
        if not parts:
            parts.append(f"<header><p class=kicker>MRR hammering report</p><h1>{escape(experiment['robot'])}</h1></header>")
        parts.append(experiment_section(experiment))
    files = "".join(f"<li><code>{name}</code>: {what}</li>" for name, what in files if (folder / name).is_file())
    parts.append(section("Files beside this one", f"<ul>{files}</ul>"))
    return (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
            f'content="width=device-width,initial-scale=1"><title>{escape(title)}</title><style>{stylesheet()}</style>'
            f"</head><body>{''.join(parts)}</body></html>\n")


def picture(run, other, kind):
    """The overview picture, about 1200 px wide, as bytes."""
    if not run.hits:
        raise data.ReportError("no swing hit anything, so there is nothing to draw")
    drawing = figures.overview(run, other)
    buffer = io.BytesIO()
    drawing.savefig(buffer, format=kind, dpi=100, facecolor=style.PAPER,
                    metadata={"Date": None} if kind == "svg" else None)
    plt.close(drawing)
    return buffer.getvalue()
